"""A coordinator that waits for a resource with a busy init is reported in the log and by `lfield ps`."""

from __future__ import annotations

import random

from lfield.bytecode.program import DeviceCallRecord
from lfield.clock import ManualClock
from lfield.compiler.program_builder import compile_program
from lfield.host.migration.init_barrier import InitBarrier
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, DeviceValue, Instruction
from lfield.testing.golden import GoldenWorld, run_until_idle, team_for
from lfield.vm.agent import Agent, MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.host_interface import PENDING, Pending
from lfield.vm.machine import Machine

MOTOR = DeviceManifest(type="Motor", driver="motor", instructions=(Instruction("home", ()),))
PROGRAM = """
resource Axis {
    Motor motor;
    init(string[] arg) { motor.home(); while (true) yield(); }
    loop count at 1.0 { }    // it waits too, and is no caller
    portal move() emit int { return 1; }
}
resource Ready { init(string[] arg) { while (true) yield(); } portal move() emit int { return 2; } }
coordinator Boss { init(string[] arg) { print(findReady("ready").move()); print(findAxis("axis").move()); } }
"""
WAITING = "boss waiting: the init of axis has neither returned nor yielded yet"


class EndlessDevice(GoldenWorld):
    """A device whose call never ends by itself."""

    def call_device(
        self, agent: Agent, thread: int, call: DeviceCallRecord, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        self.asked = agent, thread
        return PENDING


def test_a_wait_for_an_init_is_reported_once_after_a_second() -> None:
    program = compile_program(check_text(PROGRAM, devices={"Motor": MOTOR}).or_raise())
    desk, clock, log = EndlessDevice(), ManualClock(), []
    team = team_for(program, [])
    machine = Machine(program, MachineTeam(team, 0, 1), desk, clock, random.Random(1))
    inits = InitBarrier(machine.opening, log.append)
    for member in team:
        machine.start(member, AgentLimits(), generation=1)
    run_until_idle(machine, clock)
    boss = machine.agents["boss"]
    assert (desk.output, inits.wait_reason(boss)) == (["2"], "waits for the init of axis")
    for now, due, lines in [(5.0, 6.0, []), (5.9, 6.0, []), (6.0, None, [WAITING]), (9.0, None, [WAITING])]:
        inits.on_tick(now)
        assert (inits.due, log) == (due, lines)
    assert inits.wait_reason(machine.agents["axis"]) == ""

    agent, thread = desk.asked
    machine.answer(agent, thread, None, 0, "motor")
    run_until_idle(machine, clock)
    inits.on_tick(10.0)
    assert (desk.output, inits.due, log) == (["2", "1"], None, [WAITING])
