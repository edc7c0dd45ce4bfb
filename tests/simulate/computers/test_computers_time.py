"""Time on simulated computers: separate clocks, processors that take time, scenarios with an end."""

from __future__ import annotations

import asyncio
import math
import random
from dataclasses import replace

import pytest

from lfield.simulate.computers.event_queue import EventQueue, TooManyEvents
from lfield.simulate.computers.simulated_computer import SimulatedComputer
from lfield.simulate.computers.simulated_machine import MachineClock, SimulatedMachine
from lfield.simulate.computers.simulated_network import SimulatedNetwork
from lfield.simulate.hardware import Hardware
from simulation_testing.scenarios import scenario_run
from simulation_testing.scenarios.scenario import plain


def test_a_clock_runs_at_its_rate_and_boot_time_counts_suspensions() -> None:
    timeline = EventQueue()
    clock = MachineClock(timeline, start=50.0, rate=1.01)
    timeline.run(10.0)
    assert clock.awake() == clock.monotonic() == pytest.approx(60.1)
    clock.suspend(5.0)
    assert clock.suspended
    timeline.run(5.0)
    assert not clock.suspended
    assert clock.awake() == pytest.approx(60.1)
    assert clock.monotonic() == pytest.approx(65.15)


def test_time_advances_while_a_process_never_waits() -> None:
    timeline = EventQueue()
    machine = SimulatedMachine("m", timeline, random.Random(1))
    process = SimulatedComputer(
        machine, SimulatedNetwork(timeline, {"m": machine}, random.Random(2)), {}
    ).start()

    async def run_forever() -> None:
        while True:
            await asyncio.sleep(0)

    process.loop.enter(lambda: process.loop.create_task(run_forever()))
    timeline.run(0.5)
    assert timeline.now == 0.5
    assert 100 < timeline.events < 1000


def test_computation_takes_time_in_which_the_process_handles_no_event() -> None:
    timeline = EventQueue()
    machine = SimulatedMachine("m", timeline, random.Random(1))
    computer = SimulatedComputer(machine, SimulatedNetwork(timeline, {"m": machine}, random.Random(2)), {})
    one, other = computer.start().loop, computer.start().loop
    arrivals_by_host: list[tuple[str, float]] = []

    def note(what: str) -> None:
        arrivals_by_host.append((what, timeline.now))

    def computes(seconds: float) -> None:
        one.compute(seconds)
        one.call_soon(note, "later")

    one.enter(lambda: computes(0.5))
    one.enter(lambda: note("came"))
    one.freeze()
    one.thaw()
    other.enter(lambda: note("beside"))
    timeline.run(1.0)
    assert arrivals_by_host == [("beside", 0.0), ("later", 0.5), ("came", 0.5)]
    # A very short computation is charged together with later ones.
    arrivals_by_host.clear()
    for _ in range(3):
        one.enter(lambda: computes(0.0004))
    assert len(arrivals_by_host) == 2
    timeline.run(1.0)
    assert arrivals_by_host[-1] == ("later", pytest.approx(1.0012))


def test_a_wake_up_slightly_too_early_does_not_repeat_without_end() -> None:
    timeline = EventQueue()
    timeline.now, timeline.max_events = 1e6, 100
    machine = SimulatedMachine("m", timeline, random.Random(1))
    machine.clock = MachineClock(timeline, start=1.0)
    loop = (
        SimulatedComputer(machine, SimulatedNetwork(timeline, {"m": machine}, random.Random(2)), {})
        .start()
        .loop
    )
    due = loop.time() + 1.0
    arrivals: list[float] = []

    def look() -> None:
        if loop.time() <= due:
            loop.call_at(math.nextafter(due, math.inf), look)
        else:
            arrivals.append(timeline.now)

    loop.enter(look)
    timeline.run(2.0)
    assert arrivals


def test_too_many_events_end_a_simulation() -> None:
    timeline = EventQueue()
    timeline.max_events = 1000

    def again() -> None:
        timeline.after(0.0, again)

    again()
    with pytest.raises(TooManyEvents, match="1,000 events, but time is still 0"):
        timeline.run(1.0)


def test_a_scenario_without_an_end_is_a_breach(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenario_run, "MAX_EVENTS", 100)
    verdict = scenario_run.run_scenario(replace(plain(3), keep=frozenset()))
    assert [breach.name for breach in verdict.breaches] == ["endless"]


def test_a_device_stopped_by_its_watchdog_does_not_move_when_it_is_fed_again() -> None:
    timeline = EventQueue()
    hardware = Hardware(timeline, random.Random(1))
    hardware.command(1, "setVelocity", (), float("inf"))
    assert hardware.is_moving
    timeline.run(2.0)
    assert not hardware.is_moving
    hardware.feed()
    assert not hardware.is_moving
