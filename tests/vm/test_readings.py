"""Queries of telemetry: requested once, then read by the engine while they are fresh, and no longer."""

from __future__ import annotations

import random

import pytest

from lfield.clock import ManualClock
from lfield.compiler.program_builder import compile_program
from lfield.errors import DeviceError
from lfield.lang.frontend import check_text
from lfield.manifest import DeviceManifest, Instruction
from lfield.testing.golden import GoldenWorld, run_until_idle, team_for
from lfield.vm.agent import MachineTeam
from lfield.vm.engine_interface import AgentLimits, Reading
from lfield.vm.machine import Machine
from lfield.vm.memory.word_codec import bits_of_real

GAUGE = DeviceManifest(
    "Gauge",
    "test",
    (
        Instruction("level", (), "real", "m", effect="query"),
        Instruction("name", (), "string", effect="query"),
    ),
)


class Telemetry(GoldenWorld):
    """A world with one gauge that counts the requests."""

    def __init__(self, clock: ManualClock) -> None:
        super().__init__()
        self.clock, self.level, self.requests = clock, 1.0, 0
        self.known = Reading()

    def set(self, level: float, lasts: float = 1.0) -> None:
        self.level, self.known.word, self.known.until = (
            level,
            bits_of_real(level),
            self.clock.monotonic() + lasts,
        )

    def call_device(self, agent, thread, call, values):
        self.requests += 1
        if call.instruction == "name":
            return "g"
        if self.clock.monotonic() >= self.known.until:
            raise DeviceError("g", "the last level is too old", kind="DeviceTimeoutException")
        return self.level

    def telemetry_reading(self, agent, call):
        return self.known if call.instruction == "level" else None


@pytest.fixture
def start():
    def started(body: str, fields: str = "") -> tuple[Machine, Telemetry, ManualClock]:
        text = f"resource R {{ Gauge g; {fields} init(string[] a) {{ {body} }} }}"
        program = compile_program(check_text(text, devices={"Gauge": GAUGE}).or_raise())
        clock = ManualClock()
        world = Telemetry(clock)
        world.set(1.5)
        machine = Machine(program, MachineTeam(team_for(program, []), 0, 1), world, clock, random.Random(1))
        machine.start(machine.team[0], AgentLimits(), 1)
        return machine, world, clock

    return started


def test_the_host_is_asked_once_for_many_reads(start):
    machine, world, clock = start(
        "real s = 0.0; for (int i = 0; i < 100; i = i + 1) s = s + g.level(); print(s);"
    )
    run_until_idle(machine, clock)
    assert world.output == ["150.0"]
    assert world.requests == 1


def test_a_reading_follows_the_telemetry(start):
    machine, world, clock = start("print(g.level()); sleep(0.5); print(g.level());")
    machine.run()
    world.set(2.5, lasts=10.0)
    run_until_idle(machine, clock)
    assert world.output == ["1.5", "2.5"]


def test_an_old_reading_is_requested_again_and_raises_an_exception(start):
    machine, world, clock = start(
        "print(g.level()); sleep(2.0);"
        "try { print(g.level()); } catch (DeviceTimeoutException e) { print(e.message()); }"
    )
    run_until_idle(machine, clock)
    assert world.output == ["1.5", "g: the last level is too old"]


def test_a_text_is_requested_each_time(start):
    machine, world, clock = start("print(g.name()); print(g.name());")
    run_until_idle(machine, clock)
    assert world.requests == 2


def test_a_loop_that_waits_for_telemetry_is_not_parked_for_ever(start):
    machine, world, clock = start('while (g.level() < 3.0) yield(); print("there");')
    for _ in range(300):
        world.set(world.level)
        clock.advance(machine.run() or 0.01)
    assert world.output == []
    world.set(3.0)
    for _ in range(3):
        clock.advance(machine.run() or 0.01)
    assert world.output == ["there"]
