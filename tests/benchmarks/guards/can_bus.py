"""A CAN frame to another client of the bus and its echo back: the driver's bus beside python-can, on the same
kind of fake. Both run in this process; the guard's pipe, which costs every command the same, is left out."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

import can
from guards.exchanges import BATCHES, EXCHANGES, async_batches, batches
from harness.checkout import Checkout
from harness.figure import Figure
from harness.paced import Round
from harness.processes import Processes
from harness.samples import Contender, timed

from lfield import event_loop
from lfield_can.bus.can_bus import Bus
from lfield_can.bus.frames import Frame

FLYING = 8
SINGLE, SEVERAL = "an echo, one at a time", f"an echo, {FLYING} under way"


def _bus_with_echo(checkout: Checkout, processes: Processes) -> str:
    """The endpoint of a bus on which 0x101 follows every 0x100."""
    endpoint = checkout.fake(processes, "can", "--listen", "socketcand:127.0.0.1:0")
    echo = str(Path(__file__).with_name("can_echo.py"))
    checkout.run(processes, echo, *_host_and_port(endpoint)).line()
    return endpoint


def _host_and_port(endpoint: str) -> list[str]:
    return endpoint.removeprefix("socketcand:").partition("/")[0].rsplit(":", 1)


# --- python-can ---------------------------------------------------------------------------------------


def python_can(checkout: Checkout, processes: Processes) -> Contender:
    """The library alone."""
    host, port = _host_and_port(_bus_with_echo(checkout, processes))

    def both() -> Round:
        bus = can.Bus(interface="socketcand", channel="can0", host=host, port=int(port), tcp_tune=True)
        try:
            return {
                SINGLE: batches(lambda: _echoes(bus, 1, 1)),
                SEVERAL: [timed(lambda: _echoes(bus, FLYING, EXCHANGES)) / EXCHANGES for _ in range(BATCHES)],
            }
        finally:
            bus.shutdown()

    return both


def _echoes(bus: can.BusABC, flying: int, count: int) -> None:
    message = can.Message(arbitration_id=0x100, data=bytes(8), is_extended_id=False)
    for _ in range(flying):
        bus.send(message)
    sent, back = flying, 0
    while back < count:
        answer = bus.recv(1.0)
        if answer is None or answer.arbitration_id != 0x101:
            continue
        back += 1
        if sent < count:
            bus.send(message)
            sent += 1


# --- the driver ---------------------------------------------------------------------------------------


def driver(checkout: Checkout, processes: Processes) -> Contender:
    """The driver's bus."""
    endpoint = _bus_with_echo(checkout, processes)
    return lambda: {SINGLE: event_loop.run(_singles(endpoint)), SEVERAL: event_loop.run(_several(endpoint))}


async def _opened(endpoint: str, on_echo: Callable[[], None]) -> Bus:
    bus = Bus(endpoint, lambda frame: on_echo() if frame.id == 0x101 else None, print)
    await bus.open()
    return bus


async def _singles(endpoint: str) -> list[float]:
    answered = asyncio.Event()
    bus = await _opened(endpoint, answered.set)

    async def exchange() -> None:
        answered.clear()
        await bus.send(Frame(0x100, bytes(8)))
        await answered.wait()

    try:
        return await async_batches(exchange)
    finally:
        await bus.close()


async def _several(endpoint: str) -> list[float]:
    done, left = asyncio.Event(), {"to send": 0, "to come": 0}

    def send() -> None:
        left["to send"] -= 1
        bus.post(Frame(0x100, bytes(8)))

    def on_echo() -> None:
        left["to come"] -= 1
        if left["to send"]:
            send()
        if not left["to come"]:
            done.set()

    bus = await _opened(endpoint, on_echo)
    samples = []
    for _ in range(BATCHES):
        done.clear()
        left.update({"to send": EXCHANGES, "to come": EXCHANGES})
        start = time.perf_counter()
        for _ in range(FLYING):
            send()
        await done.wait()
        samples.append((time.perf_counter() - start) / EXCHANGES)
    await bus.close()
    return samples


FIGURE = Figure(
    "CAN over socketcand: seconds of an echo; ratio to python-can",
    {"python-can": python_can, "lfield_can": driver},
    base=("python-can",),
    rounds=5,
    one_size="an echo is of one frame",
    targets={"lfield_can": "1.11x"},
    notes=(f"a sample is the mean of {EXCHANGES} exchanges",),
)
