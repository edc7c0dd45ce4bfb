"""A killed process does nothing more: its coroutines are neither resumed nor unwound."""

from __future__ import annotations

import asyncio
import gc
import random
from collections.abc import AsyncIterator

import pytest

from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import closing_generators, release
from lfield.simulate.computers.simulated_computer import SimulatedComputer, SimulatedProcess
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.computers.simulated_network import SimulatedNetwork


def _computer(timeline: EventQueue) -> SimulatedComputer:
    machine = SimulatedMachine("m", timeline, random.Random(1))
    return SimulatedComputer(machine, SimulatedNetwork(timeline, {"m": machine}, random.Random(2)), {})


async def _works(said: list[str]) -> None:
    try:
        await asyncio.sleep(5.0)
        said.append("worked")
    finally:
        said.append("tidied up")
        await asyncio.sleep(0.1)


def _begun(timeline: EventQueue, said: list[str]) -> SimulatedProcess:
    process = _computer(timeline).start()
    process.loop.enter(lambda: process.loop.create_task(_works(said)))
    return process


@pytest.mark.few(0)
def test_a_killed_process_is_never_unwound() -> None:
    timeline, lines = EventQueue(), list[str]()
    process = _begun(timeline, lines)
    timeline.run(1.0)
    process.die(-9)
    del process
    timeline.run(10.0)
    gc.collect()
    assert lines == []


async def _ends_with_more(loops: list[asyncio.AbstractEventLoop]) -> None:
    try:
        await asyncio.sleep(5.0)
    finally:
        loops.append(asyncio.get_running_loop())
        await asyncio.gather(*(asyncio.sleep(1.0) for _ in range(2)))


def test_a_finally_block_after_the_simulation_uses_the_loop_of_its_process() -> None:
    """Otherwise asyncio makes a loop that is never closed, and coroutines that are never awaited."""
    timeline, loops = EventQueue(), list[asyncio.AbstractEventLoop]()
    process = _computer(timeline).start()
    process.loop.enter(lambda: process.loop.create_task(_ends_with_more(loops)))
    timeline.run(1.0)
    release(process.loop.machine)
    assert loops == [process.loop]
    assert not process.loop.machine.pinned


@pytest.mark.few(0)
def test_processes_of_a_discarded_simulation_are_not_unwound() -> None:
    lines = list[str]()
    timeline = EventQueue()
    process = _begun(timeline, lines)
    timeline.run(1.0)
    del timeline, process
    gc.collect()
    assert lines == []


def test_a_process_that_exits_is_unwound() -> None:
    timeline, lines = EventQueue(), list[str]()
    _begun(timeline, lines)
    timeline.run(6.0)
    assert lines == ["worked", "tidied up"]


async def _numbers(said: list[str]) -> AsyncIterator[int]:
    try:
        yield 1
        yield 2
    finally:
        await asyncio.sleep(0.1)
        said.append("tidied up")


async def _takes_one(said: list[str]) -> None:
    async for number in _numbers(said):
        said.append(str(number))
        break


def test_an_unfinished_generator_is_closed_by_its_process() -> None:
    timeline, lines = EventQueue(), list[str]()
    process = _computer(timeline).start()
    with closing_generators():
        process.loop.enter(lambda: process.loop.create_task(_takes_one(lines)))
        timeline.run(1.0)
    assert lines == ["1", "tidied up"]
