"""The live slots of a frame at a hop: those that a `together`, a catch or a `finally` still reads."""

from __future__ import annotations

import pytest

from lfield.bytecode.opcodes import BY_CODE
from lfield.bytecode.program import CATCH, FINALLY, LIMIT
from lfield.testing.golden import compile_text
from lfield.vm.memory.block import Block
from lfield.vm.memory.layout import FRAME, FRAME_SLOTS, Layouts
from lfield.vm.memory.liveness import Liveness
from lfield.vm.memory.threads import thread_template

PROGRAM = compile_text(
    """
    resource Arm {
      init(string[] arg) { }
      portal name(string s) emit string { return s; }
      portal stop() { }
    }
    coordinator Boss {
      init(string[] arg) {
        Arm arm = findArm("arm"); string got = "none"; string[] names = new string[2]; string spent = "x";
        string later = "y"; string other = "z";
        try {
          within (5.0) {
            together {
              got = arm.name(spent);
              names[1] = arm.name("b");
            }
          }
          arm.stop();
        } catch (NullException e) { print(later); }
        finally { print(other); arm.stop(); }
        print(got + names[0]);
      }
    }
    """
)
METHOD = next(i for i, m in enumerate(PROGRAM.core.methods) if PROGRAM.core.classes[m.owner].name == "Boss")
NAMES = {name: slot for slot, name in PROGRAM.debug.methods[METHOD].names}


def _group(head: str, which: int = 0) -> int:
    """The first instruction of a group in the method."""
    record = PROGRAM.core.methods[METHOD]
    heads = [pc for pc in range(record.entry, record.end) if BY_CODE[PROGRAM.quads[pc].op].name == head]
    pc = heads[which]
    while BY_CODE[PROGRAM.quads[pc - 1].op].name == "push":
        pc -= 1
    return pc


def _kept(pc: int) -> set[int]:
    """The slots that are not cleared in a frame at an instruction; all had a value."""
    record, layouts = PROGRAM.core.methods[METHOD], Layouts(PROGRAM)
    block = Block.empty(PROGRAM.digest, 4096)
    text = block.new_string("here")
    words = [text] * len(record.slots)
    block.new_thread(thread_template(METHOD, FRAME_SLOTS + len(record.slots), pc), words, 0)
    Liveness(PROGRAM, layouts).clear_dead(block)
    place = next(
        p for p in range(block.heap, block.top) if block.w[p] & 0xFF == FRAME and block.w[p] >> 32 > 9
    )
    slots = place + FRAME_SLOTS
    references = {offset - FRAME_SLOTS for offset in layouts.frame_references[METHOD]}
    return {slot for slot in references if slot > 0 and block.w[slots + slot] == text}


def _operands(pc: int) -> list[int]:
    found = []
    while BY_CODE[PROGRAM.quads[pc].op].name == "push":
        found.append(PROGRAM.quads[pc].a)
        pc += 1
    return found


def test_a_collected_call_keeps_the_targets_of_results() -> None:
    first, second = _group("begin"), _group("begin", 1)
    sentinel, neighbours = _operands(first)[:2]
    held = {sentinel, neighbours, *(NAMES[name] for name in ("arm", "names", "later", "other"))}
    assert _kept(first) >= {*held, NAMES["spent"]}
    # The arguments of a call are in its ticket.
    assert NAMES["spent"] not in _kept(second)
    assert _kept(second) >= held
    # If an exception is thrown, the local keeps its value.
    assert NAMES["got"] in _kept(second)


def test_fetch_keeps_the_arrays() -> None:
    sentinel, neighbours = _operands(_group("begin"))[:2]
    assert _kept(_group("fetch")) >= {sentinel, neighbours, NAMES["names"], NAMES["arm"]}


def test_leave_keeps_the_exception() -> None:
    sentinel, thrown = _operands(_group("leave"))
    neighbours = _operands(_group("begin"))[1]
    live = _kept(_group("leave"))
    assert live >= {sentinel, thrown, NAMES["later"], NAMES["other"]}
    assert neighbours not in live


def test_after_a_together_its_slots_are_not_kept() -> None:
    sentinel, neighbours = _operands(_group("begin"))[:2]
    live = _kept(_group("pcall"))
    assert live.isdisjoint({sentinel, neighbours})
    assert live >= {NAMES["arm"], NAMES["got"], NAMES["later"], NAMES["other"]}


def test_a_finally_keeps_the_exception_that_it_throws_again() -> None:
    rows = PROGRAM.core.methods[METHOD].handlers
    thrown = rows[-2].slot
    assert [row.kind for row in rows[-2:]] == [FINALLY, 3]
    live = _kept(_group("pcall", 1))
    assert thrown in live
    # The try has ended: its catches read no slots.
    assert NAMES["later"] not in live


@pytest.mark.parametrize("kind", [CATCH, FINALLY, LIMIT])
def test_the_program_has_every_kind_of_handler(kind: int) -> None:
    assert kind in [row.kind for row in PROGRAM.core.methods[METHOD].handlers]
