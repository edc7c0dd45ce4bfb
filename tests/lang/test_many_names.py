"""Hints that name what a type has stay short, however much it has."""

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


def test_an_unknown_instruction_is_answered_with_similar_ones() -> None:
    found = finding("w.driveTo();")
    assert (found.code, found.hint) == ("L305", "similar names: goTo and goToGlobal")


def test_without_similar_ones_the_first_are_named() -> None:
    found = finding("w.zz();")
    assert (found.code, found.hint) == ("L305", f"it has {', '.join(NAMES[:8])}, ...")


def test_an_unknown_field_is_answered_alike() -> None:
    found = finding("int n = w.zz;")
    assert (found.code, found.hint) == ("L304", f"its methods are {', '.join(NAMES[:8])}, ...")
