"""A portal call that is cancelled: where its thread hears of it, how long it may tidy up, what it leaves."""

from __future__ import annotations

import random
from functools import cache

import pytest
from joined_hosts import HostWorldStub

from lfield.bytecode.program import Program
from lfield.clock import ManualClock
from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, Instruction
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.vm.memory.threads import threads

MOTOR = DeviceManifest(
    type="Motor",
    driver="motor",
    instructions=(
        Instruction("turn", (), effect="actuate"),
        Instruction("stop", (), effect="actuate"),
        Instruction("angle", (), result="real", unit="rad", effect="query"),
    ),
)
CRANE = """
resource Crane {
  Motor motor; int n;
  init(string[] arg) { }
  portal lift() {
    try { motor.turn(); print("lifted"); }
    catch (CancelledException e) { print(e.message()); motor.stop(); print("stopped"); }
  }
  portal deaf() { while (true) n = n + 1; }
  portal looks() { while (motor.angle() < 9.0) n = n + 1; print("seen enough"); sleep(1.0); print("never"); }
  portal twice() { motor.turn(); motor.turn(); print("never"); }
  portal synchronized holds() { while (true) n = n + 1; }
  portal synchronized next() { print("in"); }
  portal ends() { motor.turn(); }
  portal sleeps(real seconds) { sleep(seconds); print("slept"); }
}
coordinator Boss {
  init(string[] arg) {
    Crane c = findCrane("crane");
    try { within (2.0) { %s } print("in time"); }
    catch (TimeLimitException e) { print(e.message()); }
    %s
  }
}
"""
OVER = "the time is over; crane.{}() was cancelled"
#: The same when the call took longer than its limit to end.
LATE = OVER + ", {:.1f} s late: it took that long to end"


@cache
def program(body: str, after: str) -> Program:
    return compile_program(check_text(CRANE % (body, after), "crane.L", devices={"Motor": MOTOR}).or_raise())


class Yard:
    """A crane, a boss, and a clock; `tidy` is how long a cancelled portal may take, in seconds."""

    def __init__(self, body: str, after: str = "", tidy: float = 5.0) -> None:
        self.clock, self.place = ManualClock(), HostWorldStub()
        team = [
            TeamMember(0, "crane", "Crane", "resource", 0),
            TeamMember(1, "boss", "Boss", "coordinator", 0),
        ]
        self.machine = Machine(
            program(body, after), MachineTeam(team, 0, 1), self.place, self.clock, random.Random(1)
        )
        self.place.machine = self.machine
        for member in team:
            self.machine.start(member, AgentLimits(tidy=tidy), 1)

    @property
    def crane(self) -> Agent:
        return self.machine.agents["crane"]

    @property
    def serving(self) -> int:
        """How many threads the crane has."""
        return len(list(threads(self.crane.block)))

    def pass_time(self, seconds: float) -> list[str]:
        """Let the machine run, let time pass, and let it run; everything said until now."""
        self._run()
        self.clock.advance(seconds)
        self._run()
        return self.place.output

    def _run(self) -> None:
        for _ in range(20):
            if self.machine.run() != 0.0:
                return

    def answer(self) -> None:
        """The device instruction that was asked for first is done."""
        agent, thread = self.place.waiting.pop(0)
        self.machine.answer(agent, thread, None, 0, "motor")

    def refuse(self, message: str) -> None:
        """Report that the device instruction that was asked for first was cancelled."""
        agent, thread = self.place.waiting.pop(0)
        self.machine.throw_builtin(agent, thread, "CancelledException", message, "motor")


def test_a_device_that_can_is_cancelled_and_the_portal_tidies_up_with_it() -> None:
    yard = Yard("c.lift();")
    assert yard.pass_time(1.9) == []
    yard.pass_time(0.1)
    assert len(yard.place.cancelled) == 1
    assert yard.place.output == []
    yard.refuse("turn() was cancelled: it stands")
    assert yard.pass_time(0.1) == ["turn() was cancelled: it stands"]
    yard.answer()
    assert yard.pass_time(0.1) == ["turn() was cancelled: it stands", "stopped", OVER.format("lift")]
    assert yard.serving == 0


def test_a_device_that_cannot_comes_to_its_end_and_then_the_portal_hears() -> None:
    yard = Yard("c.twice();")
    yard.place.cancels = False
    yard.pass_time(2.0)
    # However long that takes: it is not the portal that is slow.
    yard.pass_time(30.0)
    assert yard.serving == 1
    yard.answer()
    assert yard.pass_time(0.0) == [LATE.format("twice", 30.0)]
    assert yard.place.waiting == []


def test_a_result_that_crosses_its_cancel_is_too_late_for_the_limit() -> None:
    yard = Yard("c.ends();")
    yard.pass_time(2.0)
    yard.answer()
    assert yard.pass_time(0.0) == [OVER.format("ends")]


def test_an_answer_for_a_thread_that_is_no_more_is_dropped() -> None:
    yard = Yard("c.lift();")
    yard.pass_time(2.0)
    assert yard.pass_time(5.0) == [LATE.format("lift", 5.0)]
    assert yard.serving == 0
    yard.refuse("late")
    assert yard.pass_time(1.0) == [LATE.format("lift", 5.0)]
    assert not yard.crane.ended


@pytest.mark.few(1)
@pytest.mark.parametrize("tidy", [0.0, 3.0])
def test_a_portal_that_never_waits_is_ended(tidy: float) -> None:
    yard = Yard("c.deaf();", tidy=tidy)
    yard.pass_time(2.0)
    if tidy:
        assert yard.pass_time(tidy - 0.1) == []
    assert yard.pass_time(0.1) == [LATE.format("deaf", tidy) if tidy else OVER.format("deaf")]
    assert yard.serving == 0


def test_a_query_is_no_waiting_instruction_and_a_sleep_is() -> None:
    yard = Yard("c.looks();")
    yard.pass_time(2.0)
    agent, thread = yard.place.waiting.pop()
    yard.machine.answer(agent, thread, 10.0, 3, "motor")
    assert yard.pass_time(0.0) == ["seen enough", OVER.format("looks")]


def test_a_thread_that_is_ended_gives_its_monitor_back() -> None:
    yard = Yard("c.holds();", "c.next();")
    yard.pass_time(2.0)
    yard.pass_time(5.0)
    assert yard.place.output == [LATE.format("holds", 5.0), "in"]
    assert yard.crane.block.w[layout.W_OWNER] == 0


def test_a_call_in_the_queue_never_begins() -> None:
    yard = Yard("together { c.holds(); c.next(); }")
    yard.pass_time(2.0)
    assert yard.serving == 1
    yard.pass_time(5.0)
    late = "the block ends 5.0 s late: it waited for its calls and their hosts"
    assert yard.place.output == [f"{OVER.format('holds')}; crane.next() was cancelled; {late}"]


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(30.0, [LATE.format("sleeps", 58.0)]), (1.0, ["slept", LATE.format("sleeps", 58.0)])],
    ids=["after", "before"],
)
def test_a_host_that_stood_still_takes_times_in_their_order(seconds: float, said: list[str]) -> None:
    yard = Yard(f"c.sleeps({seconds});")
    assert yard.pass_time(60.0) == said


def test_a_loop_that_only_computes_is_cut() -> None:
    yard = Yard("int n = 0; while (true) n = n + 1;")
    assert yard.pass_time(1.9) == []
    assert yard.pass_time(0.1) == ["the time is over"]


def test_a_limit_that_is_left_in_time_does_nothing() -> None:
    yard = Yard("c.next();", "sleep(10.0); print(1);")
    yard.pass_time(2.5)
    assert yard.pass_time(10.0) == ["in", "in time", "1"]


def test_a_resource_that_dies_while_it_is_cancelled_ends_the_wait() -> None:
    yard = Yard("c.deaf();")
    yard.pass_time(2.0)
    yard.machine._scheduler.die(yard.crane, "a test")
    assert yard.pass_time(0.0) == []
    assert yard.machine.agents.get("boss") is None


def test_a_future_that_is_cancelled_cancels_the_instruction_of_the_device() -> None:
    yard = Yard("future<void> f = async c.ends(); sleep(1.0); f.cancel(); print(f.done());")
    yard.pass_time(1.5)
    assert len(yard.place.cancelled) == 1
    yard.refuse("turn() was cancelled: it stands")
    assert yard.pass_time(0.1) == ["true", "in time"]


def test_the_loser_of_a_race_is_cancelled_where_it_waits_for_its_device() -> None:
    yard = Yard("future<void>[] all = {async c.ends(), async c.sleeps(1.0)}; print(all.race());")
    assert yard.pass_time(1.0) == ["slept"]
    assert len(yard.place.cancelled) == 1
    yard.refuse("turn() was cancelled: it stands")
    assert yard.pass_time(0.1) == ["slept", "1", "in time"]
