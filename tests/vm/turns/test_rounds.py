"""A round of the machine: its length before the host gets control; the garbage of a portal call."""

from __future__ import annotations

import random

import pytest

from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import SLICE, SLICES_PER_RUN, TURNS_PER_RUN, Machine
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import W_SELF
from lfield.vm.turns.run_limit import SECONDS_PER_RUN

TEAM = [TeamMember(0, "store", "Store", "resource", 0), TeamMember(1, "clerk", "Clerk", "coordinator", 0)]
PROGRAM = """
class Box { public int[] kept; public Box next; }
resource Store {
  Box last; int count;
  init(string[] arg) { }
  portal ask() emit int { return count; }
  portal bump(int by) emit int { int[] spent = new int[by]; count = count + spent.length(); return count; }
  portal keep(int n) emit int {
    Box box = new Box(); box.kept = new int[n]; box.kept[0] = count; box.next = last; last = box;
    count = count + 1;
    return count;
  }
  portal fail() { throw new Exception("no"); }
}
coordinator Clerk {
  Store store;
  init(string[] arg) { store = findStore("store"); %s }
}
"""


def machine(body: str, desk: GoldenWorld | None = None, clock: ManualClock | None = None) -> Machine:
    """A store and its clerk, which has not started."""
    program = compile_text(PROGRAM % body)
    made = Machine(
        program, MachineTeam(TEAM, 0, 1), desk or GoldenWorld(), clock or ManualClock(), random.Random(1)
    )
    for member in TEAM:
        made.start(member, AgentLimits(), generation=1)
    return made


@pytest.mark.parametrize(
    ("body", "least", "most"),
    [
        ("while (true) store.ask();", 0, SLICES_PER_RUN * SLICE // 10),
        ("int i = 0; while (true) i = i + 1;", (SLICES_PER_RUN - 1) * SLICE, SLICES_PER_RUN * SLICE),
    ],
    ids=["turns", "instructions"],
)
def test_a_round_ends_after_a_number_of_turns_or_instructions(body: str, least: int, most: int) -> None:
    vm, used = machine(body), []
    vm.hooks.meter = used.append
    vm.run()
    used.clear()
    assert vm.run() == 0.0
    assert len(used) <= TURNS_PER_RUN
    assert least <= sum(used) <= most


class Slow(ManualClock):
    """A clock that advances by a millisecond at each reading."""

    def monotonic(self) -> float:
        self.advance(0.001)
        return super().monotonic()


@pytest.mark.parametrize("body", ["while (true) store.ask();", "int i = 0; while (true) i = i + 1;"])
def test_a_round_ends_when_it_has_taken_long(body: str) -> None:
    vm, turns = machine(body, clock=Slow()), []
    vm.run()
    vm.hooks.meter = turns.append
    vm.run()
    assert 1 <= len(turns) <= 1000 * SECONDS_PER_RUN + 1


def test_every_ready_thread_has_a_turn_in_a_round_of_calls() -> None:
    vm, turns = machine("while (true) store.ask();"), []
    vm.run()
    vm.hooks.meter = turns.append
    vm.run()
    assert len(turns) == TURNS_PER_RUN


def test_portals_that_keep_nothing_make_no_garbage() -> None:
    tops = []
    for calls in (1, 1000):
        vm = machine(f"for (int i = 0; i < {calls}; i = i + 1) store.ask();")
        run_until_idle(vm, ManualClock())
        assert vm.agents["store"].served == calls
        tops.append(vm.agents["store"].block.top)
    assert tops[0] == tops[1]


def test_kept_objects_of_portals_stay_and_others_are_collected() -> None:
    body = """
      int sum = 0;
      for (int i = 1; i < 60; i = i + 1) {
        sum = sum + store.keep(i) + store.bump(i);
        try { store.fail(); } catch (Exception e) { sum = sum + 1; }
      }
      print(i2s(sum));
    """
    desk = GoldenWorld()
    vm = machine(body, desk)
    expected = count = 0
    for i in range(1, 60):
        expected += (count + 1) + (count + 1 + i) + 1
        count += 1 + i
    run_until_idle(vm, ManualClock())
    store = vm.agents["store"]
    assert (store.served, desk.output) == (3 * 59, [str(expected)])
    collect(store.block, vm.layouts)
    lengths, w = [], store.block.w
    box = w[w[W_SELF] + 1]
    while box:
        lengths.append((w[w[box + 1]] >> 32) - 1)
        box = w[box + 2]
    assert lengths == list(range(59, 0, -1))
