"""Capability classes and their queries: a sound program is accepted, and each error is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from core_changes import Change, SoundCode, change_class

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.program import INT, FieldRecord
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.testing.golden import compile_text

REGISTRY = read_registry([Path(__file__).parents[1] / "golden" / "programs" / "lifting.yaml"])
SOUND = compile_text(
    """
    resource Crane {
      init(string[] arg) { while (true) yield(); }
      portal lift(real height) emit real { return height; }
      portal stop() { }
    }
    coordinator Boss { init(string[] arg) { Lift[] all = findLift("payload > 1.0"); print(explainLift()); } }
    """,
    registry=REGISTRY,
)
LIFT, CRANE, OFFER = (SOUND.class_index[name] for name in ("Lift", "Crane", "Offer"))

CODE = SoundCode(SOUND)
INIT = next(m.entry for m in SOUND.core.methods if (m.owner, m.kind) == (CRANE, "init"))
_FIELDS, _FACTS = SOUND.core.classes[LIFT].fields, SOUND.core.classes[OFFER].fields


def test_encoding_and_decoding_keep_a_program() -> None:
    decoded = decode(encode(SOUND))
    assert decoded.core == SOUND.core
    listing = disassemble(decoded)
    assert "capability Lift coordinator specific" in listing
    assert "offers, Lift" in listing
    assert "explain, Lift" in listing


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (change_class(LIFT, usage="global"), "is not a coordinator specific class"),
        (change_class(LIFT, fields=()), "does not start with the fields of offers"),
        (change_class(LIFT, fields=(FieldRecord("fact", _FIELDS[0].type), *_FIELDS[1:])), "does not start"),
        (change_class(LIFT, fields=(FieldRecord("facts", INT), *_FIELDS[1:])), "does not start"),
        (change_class(LIFT, fields=(_FIELDS[1], _FIELDS[0])), "does not start"),
        (change_class(OFFER, fields=_FACTS[:-1]), "does not start"),
        (change_class(OFFER, fields=(*_FACTS[:3], FieldRecord("score", INT), *_FACTS[4:])), "does not start"),
        (change_class(LIFT, capability=False), "only capabilities have offers"),
        (CODE.put("offers", "offers", OFFER), "only capabilities have offers"),
        (CODE.put("explain", "explain", CRANE), "only capabilities have offers"),
        (CODE.put("explain", "explain", 99), "does not exist"),
        (CODE.push("offers", 1, 1), "wrong type"),
        (CODE.push("explain", 1, 1), "wrong type"),
        (CODE.put(INIT + 1, "offers", LIFT), "only coordinators query"),
    ],
)
def test_invalid_capabilities_are_refused(change: Change, reason: str) -> None:
    CODE.accepted(lambda core: core)
    CODE.refused(change, reason)


def test_a_query_result_of_another_type_is_refused() -> None:
    CODE.refused(CODE.put("offers", "pop", 1, after=1), "the result does not fit the slot")


def test_a_condition_may_be_null() -> None:
    CODE.accepted(CODE.push("offers", 1, -1 - SOUND.core.constants.index(None)))
