"""A cancelled portal call: where its thread is interrupted, its time for cleanup, and its remains."""

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
#: The message for a call that ended later than its limit.
LATE = OVER + ", {:.1f} s late: it took that long to end"


@cache
def program(body: str, after: str) -> Program:
    return compile_program(check_text(CRANE % (body, after), "crane.L", devices={"Motor": MOTOR}).or_raise())


class Yard:
    """A crane, a boss, and a clock; `tidy` is the time for the cleanup of a cancelled portal (s)."""

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
        """The number of threads of the crane."""
        return len(list(threads(self.crane.block)))

    def pass_time(self, seconds: float) -> list[str]:
        """Run the machine, advance the clock, and run again; returns the output so far."""
        self._run()
        self.clock.advance(seconds)
        self._run()
        return self.place.output

    def _run(self) -> None:
        for _ in range(20):
            if self.machine.run() != 0.0:
                return

    def answer(self) -> None:
        """Complete the oldest device instruction."""
        agent, thread = self.place.waiting.pop(0)
        self.machine.answer(agent, thread, None, 0, "motor")

    def refuse(self, message: str) -> None:
        """Report that the oldest device instruction was cancelled."""
        agent, thread = self.place.waiting.pop(0)
        self.machine.throw_builtin(agent, thread, "CancelledException", message, "motor")


def test_a_cancelled_device_instruction_lets_the_portal_clean_up() -> None:
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


def test_a_portal_is_cancelled_after_an_uncancellable_instruction_has_ended() -> None:
    yard = Yard("c.twice();")
    yard.place.cancels = False
    yard.pass_time(2.0)
    # The portal has its whole cleanup time after the end of the instruction.
    yard.pass_time(30.0)
    assert yard.serving == 1
    yard.answer()
    assert yard.pass_time(0.0) == [LATE.format("twice", 30.0)]
    assert yard.place.waiting == []


def test_a_result_that_crosses_its_cancel_exceeds_the_limit() -> None:
    yard = Yard("c.ends();")
    yard.pass_time(2.0)
    yard.answer()
    assert yard.pass_time(0.0) == [OVER.format("ends")]


def test_an_answer_for_an_ended_thread_is_dropped() -> None:
    yard = Yard("c.lift();")
    yard.pass_time(2.0)
    assert yard.pass_time(5.0) == [LATE.format("lift", 5.0)]
    assert yard.serving == 0
    yard.refuse("late")
    assert yard.pass_time(1.0) == [LATE.format("lift", 5.0)]
    assert not yard.crane.ended


@pytest.mark.few(1)
@pytest.mark.parametrize("tidy", [0.0, 3.0])
def test_a_portal_without_waits_is_ended_after_the_cleanup_time(tidy: float) -> None:
    yard = Yard("c.deaf();", tidy=tidy)
    yard.pass_time(2.0)
    if tidy:
        assert yard.pass_time(tidy - 0.1) == []
    assert yard.pass_time(0.1) == [LATE.format("deaf", tidy) if tidy else OVER.format("deaf")]
    assert yard.serving == 0


def test_a_cancelled_portal_is_interrupted_in_a_sleep_not_in_a_query() -> None:
    yard = Yard("c.looks();")
    yard.pass_time(2.0)
    agent, thread = yard.place.waiting.pop()
    yard.machine.answer(agent, thread, 10.0, 3, "motor")
    assert yard.pass_time(0.0) == ["seen enough", OVER.format("looks")]


@pytest.mark.few(0)
def test_an_ended_thread_releases_its_monitor() -> None:
    yard = Yard("c.holds();", "c.next();")
    yard.pass_time(2.0)
    yard.pass_time(5.0)
    assert yard.place.output == [LATE.format("holds", 5.0), "in"]
    assert yard.crane.block.w[layout.W_OWNER] == 0


def test_a_queued_call_does_not_start_after_its_cancel() -> None:
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
def test_a_suspended_host_handles_expired_times_in_order(seconds: float, said: list[str]) -> None:
    yard = Yard(f"c.sleeps({seconds});")
    assert yard.pass_time(60.0) == said


def test_a_time_limit_ends_a_computing_loop() -> None:
    yard = Yard("int n = 0; while (true) n = n + 1;")
    assert yard.pass_time(1.9) == []
    assert yard.pass_time(0.1) == ["the time is over"]


def test_a_block_that_ends_in_time_clears_its_limit() -> None:
    yard = Yard("c.next();", "sleep(10.0); print(1);")
    yard.pass_time(2.5)
    assert yard.pass_time(10.0) == ["in", "in time", "1"]


@pytest.mark.few(0)
def test_a_failed_resource_ends_the_wait_for_its_cancelled_call() -> None:
    yard = Yard("c.deaf();")
    yard.pass_time(2.0)
    yard.machine._scheduler.die(yard.crane, "a test")
    assert yard.pass_time(0.0) == []
    assert yard.machine.agents.get("boss") is None


def test_a_cancelled_future_cancels_the_device_instruction() -> None:
    yard = Yard("future<void> f = async c.ends(); sleep(1.0); f.cancel(); print(f.done());")
    yard.pass_time(1.5)
    assert len(yard.place.cancelled) == 1
    yard.refuse("turn() was cancelled: it stands")
    assert yard.pass_time(0.1) == ["true", "in time"]


def test_the_loser_of_a_race_is_cancelled_in_its_device_instruction() -> None:
    yard = Yard("future<void>[] all = {async c.ends(), async c.sleeps(1.0)}; print(all.race());")
    assert yard.pass_time(1.0) == ["slept"]
    assert len(yard.place.cancelled) == 1
    yard.refuse("turn() was cancelled: it stands")
    assert yard.pass_time(0.1) == ["slept", "1", "in time"]
