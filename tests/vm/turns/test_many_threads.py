"""A thousand threads in one block: each is found at once, in any order of their ends."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle
from lfield.vm.agent import MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory.block import Block
from lfield.vm.memory.collector import collect
from lfield.vm.memory.layout import THREAD_ID, Layouts
from lfield.vm.memory.threads import count, place_of, thread_template, threads, unlink

PROGRAM = """
resource Gate {
  int sum;
  init(string[] arg) { }
  portal pass(int number) emit int {
    for (int i = 0; i < 5; i = i + 1) { sleep(0.1); sum = sum + 1; }
    return number;
  }
}
coordinator Walker {
  init(string[] arg) { int number = s2i(arg[1]); if (findGate("gate").pass(number) != number) print("no"); }
}
"""


def crowd(size: int, desk: GoldenWorld, clock: ManualClock) -> Machine:
    """So many coordinators, which have not started, before one gate."""
    team = [TeamMember(0, "gate", "Gate", "resource", 0)]
    team += [TeamMember(n, f"w{n}", "Walker", "coordinator", 0, (str(n),)) for n in range(1, size + 1)]
    machine = Machine(compile_text(PROGRAM), MachineTeam(team, 0, 1), desk, clock, random.Random(1))
    for member in team:
        machine.start(member, AgentLimits(threads=size), generation=1)
    return machine


def test_the_work_is_linear_in_the_number_of_threads(
    steps: Callable[[Callable[[], object]], int],
) -> None:
    durations = []
    for size in (30, 300):
        desk, clock = GoldenWorld(), ManualClock()
        made = crowd(size, desk, clock)
        durations.append(steps(lambda made=made, clock=clock: run_until_idle(made, clock)))  # type: ignore[misc]
        assert made.agents["gate"].served == size
        assert count(made.agents["gate"].block) == 0
    assert durations[1] < 12 * durations[0]


@pytest.mark.parametrize("seed", range(5))
def test_threads_are_found_where_the_list_has_them(seed: int) -> None:
    """With any order of starts and ends, and with moves of the heap meanwhile."""
    rng, block = random.Random(seed), Block.empty(bytes(32), 1 << 20)
    layouts = Layouts(compile_text(PROGRAM))
    template = thread_template(0, layouts.frame_words[0], 0)
    living: list[int] = []
    for _ in range(400):
        if rng.random() < 0.1:
            collect(block, layouts)
        if living and rng.random() < 0.45:
            ended = living.pop(rng.randrange(len(living)))
            unlink(block, ended)
            assert place_of(block, ended) == 0
        elif block.top + 256 < block.end:
            living.append(block.new_thread(template, [], 7))
        assert count(block) == len(living)
        assert [block.w[place + THREAD_ID] for place in threads(block)] == living[::-1]
        assert [place_of(block, thread) for thread in reversed(living)] == [*threads(block)]
