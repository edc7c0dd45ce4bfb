"""The shell of the SDO client: order of transfers, timeouts and ends, on virtual time."""

from __future__ import annotations

import asyncio
import random
import struct

import pytest

from lfield.driver import DeviceError
from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import ProcessLoop
from lfield.simulate.computers.simulated_machine import SimulatedMachine
from lfield.simulate.jumping_loop import run_jumping
from lfield_can.protocols.canopen_node import CanopenNode
from lfield_can.protocols.sdo import ABORT, ANSWER, TRIES

POSITION, VELOCITY, SPEED = (0x6064, 0), (0x606C, 0), (0x607F, 0)


class Node:
    """A node at the other end: each answer comes after the next of `delays` in seconds; None means never."""

    def __init__(self, *delays) -> None:
        self.client = CanopenNode("axis", 5, self.on_frame)
        self.delays, self.heard, self.highest = list(delays), [], 1 << 31
        self.values = {POSITION: 7, VELOCITY: 8, SPEED: 0, (0x1018, 0): 4}

    def on_frame(self, frame) -> None:
        assert frame.id == 0x605
        self.heard.append(frame.data)
        command, index, subindex, value = struct.unpack("<BHBI", frame.data)
        if command == ABORT:
            return
        if command != 0x40:
            self.values[index, subindex] = min(value, self.highest)
        delay = self.delays.pop(0) if self.delays else 0.001
        if delay is not None:
            answer = (0x43, self.values[index, subindex]) if command == 0x40 else (0x60, 0)
            data = struct.pack("<BHBI", answer[0], index, subindex, answer[1])
            asyncio.get_running_loop().call_later(delay, self.client.on_answer, data)

    @property
    def requests(self) -> list[int]:
        """The indexes that were requested."""
        return [data[1] | data[2] << 8 for data in self.heard if data[0] != ABORT]


@pytest.fixture(scope="session")
def runner():
    return lambda test: run_jumping(test())


async def test_transfers_run_one_after_the_other():
    node, open_now = Node(0.1, 0.1, 0.1), []
    answered = node.client.on_answer
    node.client.on_answer = lambda data: (open_now.append(len(node.heard)), answered(data))
    reads = (node.client.read(*key) for key in (POSITION, VELOCITY, POSITION))
    assert await asyncio.gather(*reads) == [7, 8, 7]
    assert open_now == [1, 2, 3]


async def test_silent_node_raises_an_exception_after_its_tries():
    node, running = Node(None, None, None), asyncio.get_running_loop()
    start = running.time()
    with pytest.raises(DeviceError, match=r"position 0x6064:0: no answer within 0\.3 s, 3 times") as error:
        await node.client.read(*POSITION)
    assert error.value.kind == "DeviceTimeoutException"
    assert running.time() - start == pytest.approx(TRIES * ANSWER)
    assert await node.client.read(*VELOCITY) == 8
    assert node.requests == [0x6064, 0x6064, 0x6064, 0x606C]


async def test_late_answer_is_not_taken_for_the_next_request():
    node = Node(1.0, None, None, 0.2)
    with pytest.raises(DeviceError):
        await node.client.read(*POSITION)
    node.values[POSITION] = 9
    # The late answer arrives while the client reads the identity as a probe.
    assert await node.client.read(*POSITION) == 9
    assert node.requests == [0x6064, 0x6064, 0x6064, 0x1018, 0x6064]


async def test_cancelled_transfer_frees_its_turn_and_its_answer_is_dropped():
    node, running = Node(0.2), asyncio.get_running_loop()
    first = running.create_task(node.client.read(*POSITION))
    await asyncio.sleep(0.1)
    start = running.time()
    first.cancel()
    node.values[POSITION] = 9
    assert await node.client.read(*VELOCITY) == 8
    assert running.time() - start < 0.01
    assert await node.client.read(*POSITION) == 9
    assert first.cancelled()
    assert node.requests == [0x6064, 0x606C, 0x1018, 0x6064]
    assert node.heard[1][0] == ABORT


async def test_value_that_the_drive_does_not_keep_is_an_error():
    node, written = Node(), []
    node.client.on_written = lambda *what: written.append(what)
    await node.client.write(*SPEED, 500)
    node.highest = 300
    with pytest.raises(DeviceError, match="max profile velocity 0x607F:0 was set to 400 but is 300"):
        await node.client.write(*SPEED, 400)
    assert written == [(*SPEED, struct.pack("<I", value)) for value in (500, 400)]


async def test_closing_fails_pending_transfers_and_leaves_no_timer():
    node, running = Node(None), asyncio.get_running_loop()
    read = running.create_task(node.client.read(*POSITION))
    await asyncio.sleep(0.1)
    start = running.time()
    node.client.close()
    with pytest.raises(DeviceError, match="the driver has ended"):
        await read
    assert running.time() == start
    await asyncio.sleep(10.0)
    assert node.requests == [0x6064]


def test_sdo_client_runs_on_the_loop_of_a_simulated_computer():
    """Simulated time advances only when no task is ready: a wait in a thread would never end."""
    timeline = EventQueue()
    simulated = ProcessLoop(SimulatedMachine("barn", timeline, random.Random(1)))
    results = []

    async def scenario():
        node = Node(None, 0.2)
        results.append(await node.client.read(*POSITION))
        results.append(round(timeline.now - start, 6))

    start = timeline.now
    simulated.enter(lambda: results.append(simulated.create_task(scenario())))
    timeline.run(5.0)
    assert results[1:] == [7, ANSWER + 0.2]
    simulated.close()
