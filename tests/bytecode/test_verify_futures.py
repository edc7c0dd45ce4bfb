"""Futures and waits in a monitor: a sound program, and each error of the verifier."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import (
    ANY,
    BOOLEAN,
    INT,
    REAL,
    Core,
    Program,
    Quad,
    encode_quads,
)
from lfield.bytecode.verifier import verify
from lfield.errors import ProgramFileError
from lfield.testing.golden import compile_text

SOUND = compile_text(
    """
    resource Arm {
      int n = 0;
      init(string[] arg) { yield(); }
      portal lift(real height) emit real { sleep(height); return height; }
      portal synchronized get() emit int { wait until (n > 0) within (1.5); return n; }
    }
    coordinator Boss {
      init(string[] arg) {
        Arm arm = findArm("arm");
        future<real> one = async arm.lift(1.0);
        future<real>[] all = {one, async arm.lift(2.0)};
        print(all.race());
        if (one.done()) one.cancel();
        print(one.await());
      }
    }
    """
)
FUTURE = SOUND.class_index["future<real>"]
NO_DEBUG = msgspec.structs.replace(SOUND.debug, methods=())
_PUSH = BY_NAME["push"].code

Change = Callable[[Core], Core]


def test_encoding_and_decoding_keep_a_program_with_futures() -> None:
    assert decode(encode(SOUND)).core == SOUND.core
    names = {row.name for row in BY_NAME.values() if row.code in {quad.op for quad in SOUND.quads}}
    assert names >= {"launch", "next", "ended", "cancel", "failure", "wait_limit", "wait_leave", "wait_enter"}


def _at(quads: list[Quad], name: str) -> int:
    return next(pc for pc, quad in enumerate(quads) if quad.op == BY_NAME[name].code)


def _method_at(pc: int) -> int:
    return next(i for i, method in enumerate(SOUND.core.methods) if method.entry <= pc < method.end)


def _pushed(name: str, back: int, kind: int) -> Change:
    """Make the push `back` instructions before a head push a new slot of another type."""

    def change(core: Core) -> Core:
        quads, methods = list(SOUND.quads), list(core.methods)
        pc = _at(quads, name) - back
        assert quads[pc].op == _PUSH
        method = _method_at(pc)
        slots = methods[method].slots
        methods[method] = msgspec.structs.replace(methods[method], slots=(*slots, kind))
        quads[pc] = Quad(_PUSH, len(slots), 0, 0)
        return msgspec.structs.replace(core, code=encode_quads(quads), methods=tuple(methods))

    return change


def _popped(name: str, kind: int) -> Change:
    def change(core: Core) -> Core:
        quads, methods = list(SOUND.quads), list(core.methods)
        pc = _at(quads, name) + 1
        method = _method_at(pc)
        slots = methods[method].slots
        methods[method] = msgspec.structs.replace(methods[method], slots=(*slots, kind))
        quads[pc] = Quad(BY_NAME["pop"].code, len(slots), 0, 0)
        return msgspec.structs.replace(core, code=encode_quads(quads), methods=tuple(methods))

    return change


def _replaced(name: str, other: str) -> Change:
    """Replace one head by another."""

    def change(core: Core) -> Core:
        quads = list(SOUND.quads)
        quads[_at(quads, name)] = Quad(BY_NAME[other].code, 0, 0, 0)
        return msgspec.structs.replace(core, code=encode_quads(quads))

    return change


def _class(index: int, **fields: object) -> Change:
    def change(core: Core) -> Core:
        classes = list(core.classes)
        classes[index] = msgspec.structs.replace(classes[index], **fields)
        return msgspec.structs.replace(core, classes=tuple(classes))

    return change


def _unsynchronized(core: Core) -> Core:
    methods = [msgspec.structs.replace(method, synchronized=False) for method in core.methods]
    return msgspec.structs.replace(core, methods=tuple(methods))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_pushed("launch", 1, INT), "wrong type"),
        (_pushed("ended", 1, ANY), "wrong type"),
        (_pushed("next", 1, INT), "wrong type"),
        (_pushed("cancel", 1, ANY), "wrong type"),
        (_pushed("failure", 1, REAL), "wrong type"),
        (_popped("next", REAL), "does not fit"),
        (_popped("ended", INT), "does not fit"),
        (_popped("failure", INT), "does not fit"),
        (_replaced("yield", "gather"), "only coordinators"),
        (_replaced("sleep", "launch"), "only coordinators"),
        (_class(FUTURE, usage="global"), "a type no field can have|out of scope|no value can have"),
        (_class(FUTURE, usage="resource"), "a type no field can have"),
        (_unsynchronized, "only synchronized methods of resources leave the monitor"),
        (_pushed("wait_leave", 1, INT), "wrong type"),
        (_pushed("wait_leave", 2, BOOLEAN), "wrong type"),
        (_pushed("wait_enter", 1, REAL), "wrong type"),
        (_pushed("wait_limit", 1, INT), "wrong type"),
        (_popped("wait_limit", REAL), "does not fit"),
        (_popped("wait_leave", BOOLEAN), "does not fit"),
    ],
)
def test_invalid_uses_of_futures_are_refused(change: Change, reason: str) -> None:
    with pytest.raises(ProgramFileError, match=reason):
        verify(Program(change(SOUND.core), NO_DEBUG, b""))
