"""Objects of a resource that hold its devices: each command goes to the device that its object holds."""

from __future__ import annotations

import random

import pytest

from lfield.bytecode.encoding import decode, encode
from lfield.bytecode.program import Program
from lfield.bytecode.side_effects import effectful_methods
from lfield.clock import ManualClock
from lfield.compiler.program_builder import compile_program
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, DeviceValue, Instruction, Parameter
from lfield.testing.golden import GoldenWorld, run_until_idle, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits
from lfield.vm.inspection.block_view import view
from lfield.vm.machine import Machine

MOTOR = DeviceManifest(
    type="Motor",
    driver="motor",
    instructions=(
        Instruction("turn", (Parameter("angle", "real", "rad"),), effect="actuate"),
        Instruction("angle", (), result="real", unit="rad", effect="query"),
    ),
)
LAMP = DeviceManifest(type="Lamp", driver="lamp", instructions=(Instruction("on", ()),))
WALKER = """
class Leg resource specific {
    private string name;
    private Motor hip;
    public Motor knee;
    public Leg other;
    public Leg(string n, Motor h, Motor k) { name = n; hip = h; knee = k; h.turn(0.5); }
    public void step() { hip.turn(1); knee.turn(-1.0); }
    public real bend() { return knee.angle(); }
}
class Pair resource specific {
    public Leg left;
    public Leg right;
    public Pair(Motor a, Motor b, Lamp l) {
        left = new Leg("left", a, a);
        right = new Leg("right", b, a);
        l.on();
    }
}
class Empty resource specific {
    private Motor motor;
    public void run() { motor.turn(0.0); }
}
resource Walker {
    int steps = 3;
    Motor one;
    Lamp lamp;
    Motor two;
    Pair legs;
    init(string[] arg) { legs = new Pair(one, two, lamp); while (true) yield(); }
    portal walk() { legs.left.step(); legs.right.step(); legs.right.knee.turn(2.0); two.turn(3.0); }
    portal looked() emit real { return legs.left.bend(); }
    portal empty() { new Empty().run(); }
}
coordinator Boss {
    init(string[] arg) {
        Walker w = findWalker("walker");
        w.walk();
        print(w.looked());
        try { w.empty(); }
        catch (NullException e) { print(e.message()); }
    }
}
"""


class Bench(GoldenWorld):
    """Devices that record their commands."""

    def __init__(self) -> None:
        super().__init__()
        self.commands: list[tuple[str, str, list[DeviceValue]]] = []

    def call_device(self, agent, thread, call, values):
        self.commands.append((call.field, call.instruction, values))
        return 0.25 if call.instruction == "angle" else None


@pytest.fixture(scope="module")
def program() -> Program:
    return compile_program(check_text(WALKER, devices={"Motor": MOTOR, "Lamp": LAMP}).or_raise())


def run(program: Program) -> tuple[Bench, Machine]:
    bench, clock = Bench(), ManualClock()
    machine = Machine(program, MachineTeam(team_for(program, []), 0, 1), bench, clock, random.Random(1))
    for member in machine.team:
        machine.start(member, AgentLimits(), generation=1)
    run_until_idle(machine, clock)
    return bench, machine


def test_each_object_commands_the_device_that_it_holds(program: Program) -> None:
    bench, _ = run(program)
    assert bench.commands == [
        ("one", "turn", [0.5]),
        ("two", "turn", [0.5]),
        ("lamp", "on", []),
        ("one", "turn", [1.0]),
        ("one", "turn", [-1.0]),
        ("two", "turn", [1.0]),
        ("one", "turn", [-1.0]),
        ("one", "turn", [2.0]),
        ("two", "turn", [3.0]),
        ("one", "angle", []),
    ]
    assert bench.output == ["0.25", "device of 'turn' of null"]
    assert [agent.ended for agent in bench.endings] == ["done"]


def test_only_the_resource_owns_devices(program: Program) -> None:
    devices = {
        record.name: [d.name for d in record.devices] for record in program.core.classes if record.devices
    }
    assert devices == {"Walker": ["one", "lamp", "two"]}


def test_a_portal_that_commands_through_an_object_has_side_effects(program: Program) -> None:
    acting = {program.method_name(i) for i in effectful_methods(program)}
    assert "Walker.walk" in acting
    assert "Walker.looked" not in acting


def test_the_program_is_the_same_after_writing_and_reading(program: Program) -> None:
    assert run(decode(encode(program)))[0].commands == run(program)[0].commands


def test_a_device_is_displayed_by_its_name(program: Program) -> None:
    _, machine = run(program)
    fields = dict(view(machine.agents["walker"].block, program).fields)
    assert (fields["one"], fields["two"], fields["steps"]) == ("device one", "device two", "3")
