"""Waiting costs nothing: threads that only yield are parked, and wake when their condition may have
changed."""

from __future__ import annotations

import random

from lfield.clock import ManualClock
from lfield.testing.golden import GoldenWorld, compile_text, run_until_idle, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine


def started(text: str) -> tuple[Machine, GoldenWorld, ManualClock]:
    program = compile_text(text)
    desk, clock = GoldenWorld(), ManualClock()
    machine = Machine(program, MachineTeam(team_for(program, []), 0, 1), desk, clock, random.Random(1))
    for member in machine.team:
        machine.start(member, AgentLimits(), 1)
    return machine, desk, clock


def turns_until_quiet(machine: Machine, clock: ManualClock) -> int:
    """The number of runs of the machine until no event is pending."""
    for turn in range(1000):
        pause = machine.run()
        if pause is None:
            return turn
        clock.advance(pause)
    raise AssertionError("it never came to rest")


def test_a_resource_that_waits_for_ever_is_parked_at_once() -> None:
    machine, _, clock = started("resource R { init(string[] a) { while (true) yield(); } }")
    assert turns_until_quiet(machine, clock) == 0


WAITS = """
resource R {
  boolean done;
  init(string[] a) { while (!done) yield(); print("done"); }
  portal finish() { done = true; }
}
coordinator C { init(string[] a) { sleep(5.0); findR("r").finish(); } }
"""


def test_a_thread_that_waits_for_a_field_is_parked_until_another_thread_has_run() -> None:
    machine, desk, clock = started(WAITS)
    run_until_idle(machine, clock)
    assert desk.output == ["done"]
    assert turns_until_quiet(machine, clock) == 0


def test_a_wait_for_a_field_takes_few_turns() -> None:
    machine, _, clock = started(WAITS.replace("sleep(5.0)", "sleep(0.5); sleep(500.0)"))
    start = clock.now
    runs = 0
    while clock.now < start + 400.0:
        pause = machine.run()
        assert pause is not None
        clock.advance(min(pause, start + 400.0 - clock.now))
        runs += 1
    assert runs < 60


def test_two_waiting_threads_do_not_wake_each_other() -> None:
    machine, _, clock = started(
        """
resource R {
  boolean done;
  init(string[] a) { while (!done) yield(); }
  portal wait() { while (!done) yield(); }
}
coordinator C { init(string[] a) { findR("r").wait(); } }
"""
    )
    assert turns_until_quiet(machine, clock) < 60


def test_a_loop_that_changes_a_field_between_yields_continues() -> None:
    machine, desk, clock = started(
        """
resource R { int n; init(string[] a) { while (n < 200) { n = n + 1; yield(); } print(n); } }
"""
    )
    start = clock.now
    run_until_idle(machine, clock)
    assert desk.output == ["200"]
    assert clock.now == start, "a working loop is slowed down by its yields"


def test_a_loop_that_reads_the_clock_continues() -> None:
    machine, desk, clock = started(
        """
coordinator C {
  init(string[] a) { real start = now(); while (now() < start + 2.0) yield(); print("later"); }
}
"""
    )
    run_until_idle(machine, clock)
    assert desk.output == ["later"]


def test_nothing_is_kept_of_ended_threads() -> None:
    machine, desk, clock = started(
        """
resource R { init(string[] a) { } portal pause() { now(); yield(); now(); } }
coordinator C {
  init(string[] a) { R r = findR("r"); for (int i = 0; i < 50; i = i + 1) r.pause(); print("done"); }
}
"""
    )
    run_until_idle(machine, clock)
    assert desk.output == ["done"]
    agent = machine.agents["r"]
    assert not agent.poll_counts
    assert not agent.outward_pollers
