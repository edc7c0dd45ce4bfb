"""Loops of resources: their schedule, overruns, priorities, and commands of devices."""

from __future__ import annotations

import planted_loop_bugs as bugs
import pytest
from loop_world import TWO, WagonTeam

from lfield.vm.engine_interface import AgentLimits

COUNT = "loop count at %s { n += 1; print(n); %s }"


def a_schedule_without_drift(start: float = 0.0) -> None:
    """Each body takes a part of the period, and one takes more than two."""
    wagon_team = WagonTeam(COUNT % ("10", "sleep(0.03); if (n == 40) sleep(0.25);"), start=start)
    wagon_team.run(3.95)
    assert wagon_team.output == [str(n) for n in range(1, 41)]
    assert wagon_team.run(0.22) == []
    assert wagon_team.codes == []
    # The body ends at 4.18 s: the ticks at 4.0 and 4.1 s are skipped.
    assert wagon_team.run(0.02) == []
    assert wagon_team.run(0.02) == ["41"]
    assert wagon_team.codes == ["loop-overrun"]
    assert {"loop": "count", "agent": "wagon", "skipped": 2}.items() <= wagon_team.host.lines[0].as_data()[
        "fields"
    ].items()
    assert wagon_team.run(0.3) == ["42", "43", "44"]


@pytest.mark.parametrize("start", [0.0, 1234567.1])
def test_ticks_are_on_a_grid(start: float) -> None:
    a_schedule_without_drift(start)


def test_many_ticks_do_not_drift() -> None:
    wagon_team = WagonTeam(
        "loop count every 1.0 / 3 { n += 1; } portal n() emit int { return n; }",
        "sleep(299.9); print(wagon.n());",
    )
    wagon_team.run(300.0)
    assert wagon_team.output == ["900"]


def test_loops_begin_at_the_first_pause_of_init() -> None:
    wagon_team = WagonTeam(COUNT % ("1", ""), init="motor.turn(); print(0); sleep(5); print(7);")
    assert wagon_team.run(2.5) == []
    wagon_team.answer()
    assert wagon_team.run(2.6) == ["0", "1", "2", "3"]
    assert wagon_team.run(10.0)[3:5] == ["7", "6"] or "7" in wagon_team.output


def test_reports_of_a_loop_are_limited() -> None:
    wagon_team = WagonTeam(
        """loop slow at 10 { sleep(0.15); }
        loop mute at 10 { if (n < 0) return; throw new DeviceException("x"); }"""
    )
    wagon_team.run(9.95)
    assert sorted(wagon_team.codes) == ["loop-failed", "loop-overrun"]
    wagon_team.run(10.0)
    assert sorted(wagon_team.codes) == ["loop-failed"] * 2 + ["loop-overrun"] * 2
    again = {line.code: line.as_data()["fields"] for line in wagon_team.host.lines[2:]}
    assert again["loop-failed"] == {
        "loop": "mute",
        "agent": "wagon",
        "reason": "DeviceException: x",
        "omitted": 99,
    }


def a_suppressed_body(lower: int = -1, upper: int = 2) -> None:
    """The lower body is cancelled in its instruction; the upper one does not wait for that; the lower
    commands nothing more."""
    wagon_team = WagonTeam(TWO % (lower, upper), "sleep(0.05); wagon.press(true);")
    assert wagon_team.run(0.06) == []
    assert wagon_team.host.commands == ["turn"]
    assert wagon_team.run(0.05) == ["guard"]
    # The command of the upper loop follows the cancel at once: the guard orders them by channel.
    assert wagon_team.host.cancelled == [wagon_team.host.waiting[0][1]]
    assert wagon_team.host.commands == ["turn", "stop"]
    wagon_team.refuse()
    assert wagon_team.run(0.05) == ["5.0"]
    wagon_team.answer()
    assert wagon_team.run(0.02) == ["stopped"]
    assert wagon_team.run(0.05) == ["cleans", "motor: the loop guard has a higher priority than drive"]
    assert wagon_team.host.commands == ["turn", "stop"]
    assert wagon_team.codes == ["loop-suppressed", "loop-overrun"]
    # The next tick of the lower loop is like any other.
    assert wagon_team.wagon.ended == ""
    wagon_team.run(1.0)
    assert wagon_team.machine.agents["wagon"].loops is not None
    assert not wagon_team.machine.agents["wagon"].loops.suppressed


def test_a_suppressed_body_commands_nothing() -> None:
    a_suppressed_body()


def test_an_instruction_that_cannot_be_cancelled_ends_by_itself() -> None:
    wagon_team = WagonTeam(TWO % (-1, 2), "sleep(0.05); wagon.press(true);")
    wagon_team.host.cancels = False
    wagon_team.run(0.11)
    assert wagon_team.host.commands == ["turn", "stop"]
    wagon_team.answer(1)
    assert wagon_team.run(0.01) == ["stopped"]
    wagon_team.answer()
    # The next pause throws.
    assert wagon_team.run(0.2) == ["turned", "5.0"]


def the_order_of_equal_ticks() -> None:
    """The lower loop is declared first, and its thread sleeps first: the upper one is still first."""
    wagon_team = WagonTeam(
        """loop low at 10 priority 1 { print("low"); }
        loop high at 10 priority 2 when (n < 5) { n += 1; print("high"); sleep(0.01); }"""
    )
    assert wagon_team.run(0.75) == ["high"] * 5 + ["low"] * 3


def test_at_equal_times_the_higher_priority_is_first() -> None:
    the_order_of_equal_ticks()


def an_unknown_condition() -> None:
    """A query in `when` fails: lower loops command nothing meanwhile."""
    wagon_team = WagonTeam(
        """loop low at 10 priority 1 { motor.turn(); }
        loop high at 10 priority 2 when (motor.load() > 9.0) { print("never"); }"""
    )
    wagon_team.run(0.05)
    assert wagon_team.host.commands == ["turn"]
    wagon_team.host.silent = True
    wagon_team.run(0.1)
    assert wagon_team.host.cancelled == [wagon_team.host.waiting[0][1]]
    wagon_team.refuse()
    wagon_team.run(0.5)
    assert wagon_team.host.commands == ["turn"]
    assert wagon_team.codes == ["loop-failed", "loop-suppressed", "loop-overrun"]
    wagon_team.host.silent = False
    wagon_team.run(0.1)
    assert wagon_team.host.commands == ["turn", "turn"]


def test_an_unknown_condition_suppresses() -> None:
    an_unknown_condition()


def a_loop_that_controls(priority: int = 1) -> list[str]:
    """A portal that would command a device while the body of a loop runs; returns the output of the
    coordinator."""
    wagon_team = WagonTeam(
        f'loop turn at 10 priority {priority} when (n == 0) {{ n += 1; motor.stop(); print("ends"); }}',
        "sleep(0.05); print(wagon.load()); wagon.push();",
    )
    wagon_team.run(0.06)
    commands = list(wagon_team.host.commands)
    wagon_team.answer()
    wagon_team.run(0.01)
    assert commands[0] == "stop"
    return [*wagon_team.output, *commands[1:]]


def test_portals_have_priority_0() -> None:
    assert a_loop_that_controls(1) == [
        "5.0",
        "wagon.motor: motor: the loop turn controls the devices now",
        "ends",
    ]
    assert a_loop_that_controls(0) == ["5.0", "ends", "turn"]


def control_ends_with_the_body() -> None:
    wagon_team = WagonTeam(
        "loop turn at 10 priority 1 when (n == 0) { n += 1; motor.stop(); }",
        "sleep(0.15); wagon.push();",
    )
    wagon_team.run(0.05)
    wagon_team.answer()
    wagon_team.run(0.2)
    assert wagon_team.host.commands == ["stop", "turn"]


def test_portals_command_when_the_body_has_ended() -> None:
    control_ends_with_the_body()


@pytest.mark.parametrize("rate", ["at n", "every -1.0 * n", "at 5000 + n", "every n / 0.0"])
def test_an_invalid_rate_ends_the_resource(rate: str) -> None:
    wagon_team = WagonTeam(f"loop turn {rate} {{ }}")
    wagon_team.run(1.0)
    assert wagon_team.wagon.ended == "died"
    assert wagon_team.wagon.report.startswith("ArithmeticException: ")


def test_a_heap_without_space_for_loops_ends_the_resource() -> None:
    loops = "\n".join(f"loop turn{n} at 1 {{ }}" for n in range(16))
    wagon_team = WagonTeam(loops, limits=AgentLimits(heap=2048))
    wagon_team.run(0.1)
    assert wagon_team.wagon.report.startswith("LimitException: ")


def test_loops_leave_threads_for_portals() -> None:
    loops = "\n".join(f"loop turn{n} at 1 {{ }}" for n in range(16))
    wagon_team = WagonTeam(loops, "print(wagon.load());")
    assert wagon_team.run(0.1) == ["5.0"]


def all_scenarios() -> None:
    a_schedule_without_drift()
    a_suppressed_body()
    the_order_of_equal_ticks()
    an_unknown_condition()
    control_ends_with_the_body()
    assert a_loop_that_controls(1)[-1] == "ends"


@pytest.mark.parametrize("bug", bugs.LOOP_BUGS)
def test_a_planted_loop_bug_is_found(bug: bugs.LoopBug, monkeypatch: pytest.MonkeyPatch) -> None:
    bug(monkeypatch)
    with pytest.raises(AssertionError):
        all_scenarios()
