"""Each driver against its raw vendor library, on the same fake, in turns.

CAN: a frame to another client of the bus and its echo back. Dynamixel: one read of six servos at once. Both
sides of a comparison run in this process and talk to the same fake; the driver's side is what its devices
use, without the guard's pipe, which costs every command the same few tenths of a millisecond.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import Any

import can
import dynamixel_sdk
from harness import Children, Figure, Row, in_turns, median, microseconds, percentile, timed, times

from lfield import loop
from lfield_can.bus.bus import Bus as CanBus
from lfield_can.bus.frames import Frame
from lfield_dynamixel.bus.bus import Bus as ServoBus
from lfield_dynamixel.bus.chain import Chain, Node
from lfield_dynamixel.bus.port import SerialPort

ROUNDS, BATCHES, EXCHANGES, FLYING = 5, 5, 100, 8
#: What the driver must reach of the raw library's exchanges a second.
TARGET = 0.9

_HERE = Path(__file__).parent
SERVOS = tuple(range(1, 7))
#: The range from present current to present position of the X series.
START, SIZE = 126, 10


def figure() -> Figure:
    """Exchanges a second."""
    rows = [*_can_rows(), *_servo_rows()]
    note = f"{ROUNDS} rounds of {BATCHES} batches of {EXCHANGES} exchanges; a sample is the mean of a batch"
    return Figure("Drivers; ratio of exchanges a second to the raw library's", rows, (note,))


def _rows(samples: dict[str, list[float]], case: str, raw: str, own: str) -> Iterable[Row]:
    for name in (raw, own):
        taken = samples[name]
        ratio = median(samples[raw]) / median(taken)
        target = f"{TARGET:.2f}x" if name == own else ""
        yield Row(
            case, name, microseconds(median(taken)), microseconds(percentile(taken, 99)), times(ratio), target
        )
        case = ""


def _batches(exchange: Callable[[], object]) -> list[float]:
    samples = []
    for _ in range(BATCHES):
        start = time.perf_counter()
        for _ in range(EXCHANGES):
            exchange()
        samples.append((time.perf_counter() - start) / EXCHANGES)
    return samples


async def _async_batches(exchange: Callable[[], Awaitable[object]]) -> list[float]:
    samples = []
    for _ in range(BATCHES):
        start = time.perf_counter()
        for _ in range(EXCHANGES):
            await exchange()
        samples.append((time.perf_counter() - start) / EXCHANGES)
    return samples


# --- CAN ----------------------------------------------------------------------------------------------


def _can_rows() -> Iterable[Row]:
    with Children() as children:
        hub = children.start(sys.executable, "-m", "lfield_sim", "can", "--listen", "socketcand:127.0.0.1:0")
        endpoint = hub.line().split()[1]
        host, port = endpoint.removeprefix("socketcand:").partition("/")[0].rsplit(":", 1)
        echo = children.start(sys.executable, str(_HERE / "can_echo.py"), host, port)
        echo.line()
        single = {"python-can": lambda: _raw_echoes(host, port), "lfield_can": lambda: _own_echoes(endpoint)}
        several = {
            "python-can": lambda: _raw_flood(host, port),
            "lfield_can": lambda: _own_flood(endpoint),
        }
        samples, floods = in_turns(single, ROUNDS), in_turns(several, ROUNDS)
    yield from _rows(samples, "CAN echo over socketcand, one at a time", "python-can", "lfield_can")
    yield from _rows(floods, f"the same, {FLYING} under way", "python-can", "lfield_can")


def _raw_bus(host: str, port: str) -> Any:
    return can.Bus(interface="socketcand", channel="can0", host=host, port=int(port), tcp_tune=True)


def _raw_echoes(host: str, port: str) -> list[float]:
    bus, message = (
        _raw_bus(host, port),
        can.Message(arbitration_id=0x100, data=bytes(8), is_extended_id=False),
    )

    def exchange() -> None:
        bus.send(message)
        while (answer := bus.recv(1.0)) is not None and answer.arbitration_id != 0x101:
            pass

    try:
        return _batches(exchange)
    finally:
        bus.shutdown()


def _raw_flood(host: str, port: str) -> list[float]:
    bus, message = (
        _raw_bus(host, port),
        can.Message(arbitration_id=0x100, data=bytes(8), is_extended_id=False),
    )

    def batch() -> None:
        for _ in range(FLYING):
            bus.send(message)
        sent, back = FLYING, 0
        while back < EXCHANGES:
            answer = bus.recv(1.0)
            if answer is None or answer.arbitration_id != 0x101:
                continue
            back += 1
            if sent < EXCHANGES:
                bus.send(message)
                sent += 1

    try:
        return [timed(batch) / EXCHANGES for _ in range(BATCHES)]
    finally:
        bus.shutdown()


def _own_echoes(endpoint: str) -> list[float]:
    async def main() -> list[float]:
        answered = asyncio.Event()

        def on_frame(frame: Frame) -> None:
            if frame.id == 0x101:
                answered.set()

        bus = CanBus(endpoint, on_frame, print)
        await bus.open()

        async def exchange() -> None:
            answered.clear()
            await bus.send(Frame(0x100, bytes(8)))
            await answered.wait()

        try:
            return await _async_batches(exchange)
        finally:
            await bus.close()

    return loop.run(main())


def _own_flood(endpoint: str) -> list[float]:
    async def main() -> list[float]:
        done, counts = asyncio.Event(), {"sent": 0, "back": 0}

        def on_frame(frame: Frame) -> None:
            if frame.id != 0x101:
                return
            counts["back"] += 1
            if counts["sent"] < EXCHANGES:
                counts["sent"] += 1
                bus.post(Frame(0x100, bytes(8)))
            if counts["back"] == EXCHANGES:
                done.set()

        bus = CanBus(endpoint, on_frame, print)
        await bus.open()
        samples = []
        for _ in range(BATCHES):
            done.clear()
            counts.update(sent=FLYING, back=0)
            start = time.perf_counter()
            for _ in range(FLYING):
                bus.post(Frame(0x100, bytes(8)))
            await done.wait()
            samples.append((time.perf_counter() - start) / EXCHANGES)
        await bus.close()
        return samples

    return loop.run(main())


# --- Dynamixel ----------------------------------------------------------------------------------------


def _servo_rows() -> Iterable[Row]:
    with Children() as children:
        servos = [word for number in SERVOS for word in ("--servo", f"{number}:XM430-W350")]
        fake = children.start(sys.executable, "-m", "lfield_sim", "dynamixel", *servos, "--baud", "4000000")
        endpoint = fake.line().split()[1]
        names = {
            "dynamixel_sdk": lambda: _raw_reads(endpoint),
            "lfield_dynamixel": lambda: _own_reads(endpoint),
        }
        samples = in_turns(names, ROUNDS)
    yield from _rows(samples, "six servos, fast sync read", "dynamixel_sdk", "lfield_dynamixel")


def _raw_reads(endpoint: str) -> list[float]:
    path, baud = endpoint.removeprefix("serial:").rsplit(":", 1)
    port = dynamixel_sdk.PortHandler(path)
    port.openPort()
    port.setBaudRate(int(baud))
    reader = dynamixel_sdk.GroupSyncRead(port, dynamixel_sdk.PacketHandler(2.0), START, SIZE)
    for number in SERVOS:
        reader.addParam(number)

    def exchange() -> None:
        # On a busy computer its deadline is sometimes too short; the time of that counts.
        while reader.fastSyncRead() != dynamixel_sdk.COMM_SUCCESS:
            pass

    try:
        return _batches(exchange)
    finally:
        port.closePort()


def _own_reads(endpoint: str) -> list[float]:
    async def main() -> list[float]:
        bus = ServoBus(lambda owner: SerialPort(endpoint, owner, print), print, lambda: None)
        bus.open()
        chain, nodes = Chain(bus), [Node(number) for number in SERVOS]

        async def exchange() -> None:
            found = await chain.sync_read(nodes, START, SIZE)
            if len(found) < len(SERVOS):
                raise RuntimeError("a servo did not answer")

        try:
            return await _async_batches(exchange)
        finally:
            bus.close()

    return loop.run(main())
