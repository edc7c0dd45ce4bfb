"""A coordinator that waits for a resource whose init is busy: the log and `lfield ps` say so."""

from __future__ import annotations

import random

from lfield.bytecode.program import DeviceCall
from lfield.clock import ManualClock
from lfield.compiler.build import compile_program
from lfield.host.inits import Inits
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, DeviceValue, Instruction
from lfield.testing.golden import Desk, settle, team_for
from lfield.vm.agent import Agent
from lfield.vm.contract import Limits
from lfield.vm.machine import Machine
from lfield.vm.world import PENDING, Pending

MOTOR = DeviceManifest(type="Motor", driver="motor", instructions=(Instruction("home", ()),))
PROGRAM = """
resource Axis {
    Motor motor;
    init(string[] arg) { motor.home(); while (true) yield(); }
    portal move() emit int { return 1; }
}
resource Ready { init(string[] arg) { while (true) yield(); } portal move() emit int { return 2; } }
coordinator Boss { init(string[] arg) { print(findReady("ready").move()); print(findAxis("axis").move()); } }
"""
TOLD = "boss waits for axis, whose init has not come to its first pause"


class Homing(Desk):
    """A device that is never done by itself."""

    def device(
        self, agent: Agent, thread: int, call: DeviceCall, values: list[DeviceValue]
    ) -> DeviceValue | Pending:
        self.asked = agent, thread
        return PENDING


def test_who_waits_for_an_init_is_told_of_after_a_second_and_once() -> None:
    program = compile_program(check_text(PROGRAM, devices={"Motor": MOTOR}).or_raise())
    desk, clock, log = Homing(), ManualClock(), []
    team = team_for(program, [])
    machine = Machine(program, team, 0, 1, desk, clock, random.Random(1))
    inits = Inits(machine.opening, log.append)
    for member in team:
        machine.start(member, Limits(), generation=1)
    settle(machine, clock)
    boss = machine.agents["boss"]
    assert (desk.output, inits.waits(boss)) == (["2"], "waits for the init of axis")
    for now, due, told in [(5.0, 6.0, []), (5.9, 6.0, []), (6.0, None, [TOLD]), (9.0, None, [TOLD])]:
        inits.look(now)
        assert (inits.due, log) == (due, told)
    assert inits.waits(machine.agents["axis"]) == ""

    agent, thread = desk.asked
    machine.answer(agent, thread, None, 0, "motor")
    settle(machine, clock)
    inits.look(10.0)
    assert (desk.output, inits.due, log) == (["2", "1"], None, [TOLD])
