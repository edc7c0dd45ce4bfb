"""Hints list a limited number of names."""

from __future__ import annotations

from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, Instruction
from lfield.text.source_text import Diagnostic

NAMES = ("goTo", "goToGlobal", *(f"read{letter}{letter}" for letter in "ABCDEFGHIJKLMNOP"))
DEVICE = DeviceManifest(
    "Wide", "wide", tuple(Instruction(name, (), result="int", effect="query") for name in NAMES)
)


def finding(statement: str) -> Diagnostic:
    program = f"resource R {{ Wide w; init(string[] arg) {{ {statement} }} }}"
    (found,) = check_text(program, devices={"Wide": DEVICE}).diagnostics
    return found


def test_unknown_instruction_gets_similar_names() -> None:
    found = finding("w.driveTo();")
    assert (found.code, found.hint) == ("L305", "similar names: goTo and goToGlobal")


def test_unknown_instruction_without_similar_names_gets_the_first_names() -> None:
    found = finding("w.zz();")
    assert (found.code, found.hint) == ("L305", f"it has {', '.join(NAMES[:8])}, ...")


def test_unknown_field_gets_a_list_of_methods() -> None:
    found = finding("int n = w.zz;")
    assert (found.code, found.hint) == ("L304", f"its methods are {', '.join(NAMES[:8])}, ...")
