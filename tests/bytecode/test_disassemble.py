"""The listing of a program."""

from __future__ import annotations

from program_draft import ARM_LIFT, Draft

from lfield.bytecode.disassembler import disassemble
from lfield.bytecode.program import SourceText

_LIFT = """\
portal Arm.lift() int
  ^0   Arm this
  ^1   Box
  ^2   real
  ^3   int
  ^4   Exception
  32-34 catch Exception ^4 at L35
; sample.L:1  resource Arm {}
    31  frame, Arm.lift()
    32  push, ^2
    33  device, hand.grip
    34  pop, ^3
   L35  return, ^3
"""

_CLASSES = """\
class Box
    0  int value
    1  Box next

resource Arm
    0  string id
    1  Gripper hand

coordinator Guide
    0  Arm arm

class Tool resource specific
"""


def test_a_listing_shows_names_instead_of_numbers() -> None:
    listing = disassemble(Draft().program())
    assert _CLASSES in listing
    assert _LIFT in listing


def test_every_kind_of_operand_is_listed() -> None:
    listing = disassemble(Draft().program())
    for line in (
        "    L8  gete, ^2, ^4, 1",
        "     9  getf, ^5, ^0, .next",
        "    12  bnz, L8, ^3",
        "     4  newarray, ^4, int[], 1",
        '    19  lds, ^2, "word"',
        "    23  new, ^3, Tool",
        "    27  push, null",
        "    39  find, Arm",
        "    49  push, 0.5",
    ):
        assert f"\n{line}\n" in listing


def test_methods_have_names_without_debug_information() -> None:
    draft = Draft()
    draft.debug = []
    assert "    50  pcall, Arm.lift\n" in disassemble(draft.program())


def test_a_listing_contains_no_control_characters() -> None:
    draft = Draft()
    draft.sources = [SourceText("a\x1b[2J.L", "\x1b]0;owned\x07\n")]
    draft.constants[4] = "\x9b31m"
    listing = disassemble(draft.program())
    assert all(character.isprintable() or character == "\n" for character in listing)
    assert r"\x9b31m" in listing


def test_a_line_after_the_end_of_the_source_is_listed_without_text() -> None:
    draft = Draft()
    draft.debug[ARM_LIFT] = type(draft.debug[ARM_LIFT])(0, ((0, 999),), (), "lift()")
    assert "; sample.L:999\n" in disassemble(draft.program())
