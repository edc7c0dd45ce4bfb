"""A wagon with loops, whose motor and lamp answer when the test decides."""

from __future__ import annotations

import random
from functools import cache

from joined_hosts import HostWorldStub

from lfield.bytecode.program import DeviceCallRecord, Program
from lfield.clock import ManualClock
from lfield.compiler.program_builder import compile_program
from lfield.errors import DeviceError
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, DeviceValue, Instruction
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent, MachineTeam, TeamMember
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.host_interface import PENDING, Pending
from lfield.vm.machine import Machine

MOTOR = DeviceManifest(
    type="Motor",
    driver="motor",
    instructions=(
        Instruction("turn", (), effect="actuate"),
        Instruction("stop", (), effect="actuate"),
        Instruction("load", (), result="real", unit="N", effect="query"),
    ),
)
WAGON = """
resource Wagon {
  Motor motor; boolean near; int n; int cleaned;
  init(string[] arg) { %s }
  %s
  portal press(boolean on) { near = on; }
  portal push() { motor.turn(); print("pushed"); }
  portal load() emit real { return motor.load(); }
}
coordinator Boss {
  init(string[] arg) {
    Wagon wagon = findWagon("wagon");
    try { %s } catch (DeviceException e) { print(e.source() + ": " + e.message()); }
  }
}
"""
#: A body in a device instruction, and a loop above it.
TWO = """
  loop drive at 10 priority %d {
    n += 1;
    if (n > 1) return;
    try { motor.turn(); print("turned"); }
    finally { print(motor.load()); sleep(0.1); print("cleans");
      try { motor.turn(); } catch (CancelledException e) { print(e.message()); }
    }
  }
  loop guard at 10 priority %d when (near) { print("guard"); motor.stop(); near = false; print("stopped"); }
"""


@cache
def program(loops: str, boss: str, init: str) -> Program:
    text = WAGON % (init, loops, boss)
    return compile_program(check_text(text, "wagon.L", devices={"Motor": MOTOR}).or_raise())


class WagonHost(HostWorldStub):
    """A host that stores its log, and answers queries immediately with 5 N, except while `silent`."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[LogLine] = []
        self.commands: list[str] = []
        self.silent = False

    def report(self, agent: Agent, line: LogLine) -> None:
        self.lines.append(line)

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        if call.effect == "query":
            if self.silent:
                raise DeviceError("motor", "silent")
            return 5.0
        self.commands.append(call.instruction)
        self.waiting.append((agent, thread))
        return PENDING


class WagonTeam:
    """A wagon, a boss, and a clock."""

    def __init__(
        self,
        loops: str,
        boss: str = "",
        init: str = "",
        limits: AgentLimits | None = None,
        start: float = 0.0,
    ) -> None:
        self.clock, self.host = ManualClock(start), WagonHost()
        team = [
            TeamMember(0, "wagon", "Wagon", "resource", 0),
            TeamMember(1, "boss", "Boss", "coordinator", 0),
        ]
        compiled = program(loops, boss, init)
        self.machine = Machine(compiled, MachineTeam(team, 0, 1), self.host, self.clock, random.Random(1))
        self.host.machine = self.machine
        for member in team:
            self.machine.start(member, limits or AgentLimits(), 1)

    @property
    def wagon(self) -> Agent:
        return self.machine.agents["wagon"]

    @property
    def output(self) -> list[str]:
        return self.host.output

    @property
    def codes(self) -> list[str]:
        """The codes of the log."""
        return [line.code for line in self.host.lines]

    def run(self, until: float) -> list[str]:
        """Run to this time after the start; everything printed since the last call."""
        line_count = len(self.output)
        end = self.clock.now + until
        while True:
            pause = self.machine.run()
            if pause == 0.0:
                continue
            if pause is None or self.clock.now + pause > end:
                self.clock.advance(max(0.0, end - self.clock.now))
                return self.output[line_count:]
            self.clock.advance(pause)

    def answer(self, number: int = 0) -> None:
        """End a device instruction."""
        agent, thread = self.host.waiting.pop(number)
        self.machine.answer(agent, thread, None, 0, "motor")

    def refuse(self, number: int = 0) -> None:
        """Cancel a device instruction; the motor stands."""
        agent, thread = self.host.waiting.pop(number)
        self.machine.throw_builtin(agent, thread, "CancelledException", "turn() was cancelled", "motor")
