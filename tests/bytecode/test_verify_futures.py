"""Futures and waits in a monitor: a sound program is accepted, and each error is refused."""

from __future__ import annotations

import msgspec
import pytest
from core_changes import Change, SoundCode, change_class

from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import (
    ANY,
    BOOLEAN,
    INT,
    REAL,
    Core,
)
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
CODE = SoundCode(SOUND)


def test_encoding_and_decoding_keep_a_program_with_futures() -> None:
    assert decode(encode(SOUND)).core == SOUND.core
    names = {row.name for row in BY_NAME.values() if row.code in {quad.op for quad in SOUND.quads}}
    assert names >= {"launch", "next", "ended", "cancel", "failure", "wait_limit", "wait_leave", "wait_enter"}


def _unsynchronized(core: Core) -> Core:
    methods = [msgspec.structs.replace(method, synchronized=False) for method in core.methods]
    return msgspec.structs.replace(core, methods=tuple(methods))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (CODE.with_slot("launch", -1, INT), "wrong type"),
        (CODE.with_slot("ended", -1, ANY), "wrong type"),
        (CODE.with_slot("next", -1, INT), "wrong type"),
        (CODE.with_slot("cancel", -1, ANY), "wrong type"),
        (CODE.with_slot("failure", -1, REAL), "wrong type"),
        (CODE.with_slot("next", 1, REAL), "does not fit"),
        (CODE.with_slot("ended", 1, INT), "does not fit"),
        (CODE.with_slot("failure", 1, INT), "does not fit"),
        (CODE.put("yield", "gather"), "only coordinators"),
        (CODE.put("sleep", "launch"), "only coordinators"),
        (change_class(FUTURE, usage="global"), "a type no field can have|out of scope|no value can have"),
        (change_class(FUTURE, usage="resource"), "a type no field can have"),
        (_unsynchronized, "only synchronized methods of resources leave the monitor"),
        (CODE.with_slot("wait_leave", -1, INT), "wrong type"),
        (CODE.with_slot("wait_leave", -2, BOOLEAN), "wrong type"),
        (CODE.with_slot("wait_enter", -1, REAL), "wrong type"),
        (CODE.with_slot("wait_limit", -1, INT), "wrong type"),
        (CODE.with_slot("wait_limit", 1, REAL), "does not fit"),
        (CODE.with_slot("wait_leave", 1, BOOLEAN), "does not fit"),
    ],
)
def test_invalid_uses_of_futures_are_refused(change: Change, reason: str) -> None:
    CODE.refused(change, reason)
