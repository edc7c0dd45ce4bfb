"""Capability classes and their queries: a sound program, and each error of the verifier."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import INT, Core, FieldRecord, Program, Quad, encode_quads
from lfield.bytecode.verifier import verify
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.errors import ProgramFileError
from lfield.testing.golden import compile_text

REGISTRY = read_registry([Path(__file__).parents[1] / "golden" / "programs" / "lifting.yaml"])
SOUND = compile_text(
    """
    resource Crane {
      init(string[] arg) { while (true) yield(); }
      portal lift(real height) emit real { return height; }
      portal stop() { }
    }
    coordinator Boss { init(string[] arg) { Lift[] who = findLift("payload > 1.0"); print(explainLift()); } }
    """,
    registry=REGISTRY,
)
LIFT, CRANE, OFFER = (SOUND.class_index[name] for name in ("Lift", "Crane", "Offer"))

Change = Callable[[Core], Core]


def _class(index: int, **fields: object) -> Change:
    def change(core: Core) -> Core:
        classes = list(core.classes)
        classes[index] = msgspec.structs.replace(classes[index], **fields)
        return msgspec.structs.replace(core, classes=tuple(classes))

    return change


@dataclass(frozen=True)
class _Head:
    """Changes the class of the first instruction of that name, or the operand pushed before it."""

    name: str
    operand: int | None = None
    pushed: int | None = None

    def __call__(self, core: Core) -> Core:
        quads = list(SOUND.quads)
        at = next(i for i, quad in enumerate(quads) if quad.op == BY_NAME[self.name].code)
        if self.operand is not None:
            quads[at] = quads[at]._replace(a=self.operand)
        if self.pushed is not None:
            quads[at - 1] = quads[at - 1]._replace(a=self.pushed)
        return msgspec.structs.replace(core, code=encode_quads(quads))


def _in_resource(core: Core) -> Core:
    """Put a query in the init of a resource, in place of its yield."""
    entry = next(m.entry for m in core.methods if (m.owner, m.kind) == (CRANE, "init"))
    quads = list(SOUND.quads)
    assert quads[entry + 1].op == BY_NAME["yield"].code
    quads[entry + 1] = Quad(BY_NAME["offers"].code, LIFT, 0, 0)
    return msgspec.structs.replace(core, code=encode_quads(quads))


_FIELDS, _FACTS = SOUND.core.classes[LIFT].fields, SOUND.core.classes[OFFER].fields


def test_encoding_and_decoding_keep_a_program() -> None:
    again = decode(encode(SOUND))
    assert again.core == SOUND.core
    listing = disassemble(again)
    assert "capability Lift coordinator specific" in listing
    assert "offers, Lift" in listing
    assert "explain, Lift" in listing


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (_class(LIFT, usage="global"), "is not a coordinator specific class"),
        (_class(LIFT, fields=()), "does not start with the fields of offers"),
        (_class(LIFT, fields=(FieldRecord("fact", _FIELDS[0].type), *_FIELDS[1:])), "does not start"),
        (_class(LIFT, fields=(FieldRecord("facts", INT), *_FIELDS[1:])), "does not start"),
        (_class(LIFT, fields=(_FIELDS[1], _FIELDS[0])), "does not start"),
        (_class(OFFER, fields=_FACTS[:-1]), "does not start"),
        (_class(OFFER, fields=(*_FACTS[:3], FieldRecord("score", INT), *_FACTS[4:])), "does not start"),
        (_class(LIFT, capability=False), "only capabilities have offers"),
        (_Head("offers", operand=OFFER), "only capabilities have offers"),
        (_Head("explain", operand=CRANE), "only capabilities have offers"),
        (_Head("explain", operand=99), "does not exist"),
        (_Head("offers", pushed=1), "wrong type"),
        (_Head("explain", pushed=1), "wrong type"),
        (_in_resource, "only coordinators query"),
    ],
)
def test_invalid_capabilities_are_refused(change: Change, reason: str) -> None:
    verify(Program(SOUND.core, SOUND.debug, b""))
    with pytest.raises(ProgramFileError, match=reason):
        verify(Program(change(SOUND.core), SOUND.debug, b""))


def test_a_query_result_of_another_type_is_refused() -> None:
    quads = list(SOUND.quads)
    at = next(i for i, quad in enumerate(quads) if quad.op == BY_NAME["offers"].code)
    quads[at + 1] = quads[at + 1]._replace(a=1)
    core = msgspec.structs.replace(SOUND.core, code=encode_quads(quads))
    with pytest.raises(ProgramFileError, match="the result does not fit the slot"):
        verify(Program(core, SOUND.debug, b""))


def test_a_condition_may_be_null() -> None:
    nothing = -1 - SOUND.core.constants.index(None)
    verify(Program(_Head("offers", pushed=nothing)(SOUND.core), SOUND.debug, b""))
