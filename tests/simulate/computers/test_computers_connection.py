"""A simulated connection whose reader is busy: data and the end of the stream wait in order."""

from __future__ import annotations

import asyncio
import random

from lfield.simulate.computers.event_queue import EventQueue
from lfield.simulate.computers.process_loop import ProcessLoop
from lfield.simulate.computers.simulated_connection import SimulatedConnection
from lfield.simulate.computers.simulated_machine import NetworkPaths, SimulatedMachine


class Slow(asyncio.Protocol):
    """Reads one piece, then nothing until it is resumed."""

    def __init__(self) -> None:
        self.got: list[bytes | None] = []

    def connection_made(self, transport) -> None:
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.got.append(data)
        self.transport.pause_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        self.got.append(None)


def test_data_that_arrives_while_reading_is_paused_waits_in_order():
    timeline, reader = EventQueue(), Slow()
    alpha, bravo = (ProcessLoop(SimulatedMachine(name, timeline, random.Random(1))) for name in "ab")
    near, far = SimulatedConnection(NetworkPaths(random.Random(2)), alpha, bravo, (("a", 1), ("b", 2))).ends
    alpha.enter(lambda: near.start(asyncio.Protocol))
    bravo.enter(lambda: far.start(lambda: reader))
    for piece in (b"one", b"two"):
        near.write(piece)
    near.close()
    timeline.run(1.0)
    assert reader.got == [b"one"]
    assert not far.is_reading()
    bravo.enter(far.resume_reading)
    timeline.run(2.0)
    assert reader.got == [b"one", b"two"]
    bravo.enter(far.resume_reading)
    bravo.enter(far.resume_reading)
    timeline.run(3.0)
    assert reader.got == [b"one", b"two", None]
    assert not far.is_reading()
    alpha.close()
    bravo.close()
