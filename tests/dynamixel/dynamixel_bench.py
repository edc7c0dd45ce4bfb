"""A bench: the driver and the fake chain joined in memory, in time that jumps over every wait."""

from __future__ import annotations

import asyncio
from typing import Any

from lfield.driver import DeviceBinding
from lfield.simulate.time import LoopClock, run_jumping
from lfield.testing.reports import KeptReports
from lfield_dynamixel import PLUGIN
from lfield_dynamixel.driver import DynamixelDriver
from lfield_sim.dynamixel.ax import make_servo
from lfield_sim.dynamixel.chain import Chain
from lfield_sim.dynamixel.model import BAUDS, model_named

MANIFESTS = PLUGIN.read_manifests()
BAUD = 1_000_000
#: Its code in the register of an AX.
AX_BAUD = 1
START = 1000.0


class MemoryPort:
    """A port whose other end is the fake; replies come when the wire has carried them."""

    baud, latency = BAUD, 0.0

    def __init__(self, bench: Bench, events: Any) -> None:
        self.bench, self.events = bench, events
        self.plugged = True

    def open(self) -> None:
        self.bench.port = self

    def write(self, data: bytes) -> bool:
        if not self.plugged:
            return False
        loop = asyncio.get_running_loop()
        self.bench.sent.append((loop.time(), data))
        for reply in self.bench.chain.receive(data, loop.time(), BAUD):
            loop.call_at(reply.at, self._deliver, reply.data)
        return True

    def _deliver(self, data: bytes) -> None:
        if self.plugged:
            self.events.received(data)

    def unplug(self) -> None:
        self.plugged = False
        self.events.lost("/dev/ttyTEST is gone (it was unplugged)")

    def plug(self) -> None:
        self.plugged = True
        self.events.back()

    def close(self) -> None:
        pass


class BenchDriver(DynamixelDriver):
    bench: Bench

    def _make_port(self, events):
        return MemoryPort(self.bench, events)


class Bench(KeptReports):
    """A chain of fakes, and a driver with one device for them; what the driver reports is kept."""

    def __init__(
        self, *ids: int, fake: str = "XL330-M288", limits=None, safe_state="torque_hold", ttl=0.5,
        extra=(), waivers=(), **options: Any,
    ) -> None:  # fmt: skip
        super().__init__()
        numbers = ids or (1,)
        servos = [make_servo(model_named(fake), START) for _ in numbers]
        for number, servo in zip(numbers, servos, strict=True):
            servo.table.put("id", number)
            servo.table.put("baud_rate", BAUDS.index(BAUD) if servo.protocol == 2 else AX_BAUD)
        self.servos = dict(zip(numbers, servos, strict=True))
        self.chain = Chain(servos)
        self.group = len(numbers) > 1
        kind = "DynamixelGroup" if self.group else "Dynamixel"
        given: dict[str, Any] = {o.name: o.default for o in MANIFESTS[kind].options}
        given.update({"ids": list(numbers)} if self.group else {"id": numbers[0]})
        self.binding = DeviceBinding(
            agent="alpha", field="joint", type=kind, driver="dynamixel", endpoint=f"serial:/dev/null:{BAUD}",
            safe_state=safe_state, ttl=ttl, limits=limits or {}, options={**given, **options},
            waivers=list(waivers),
        )  # fmt: skip
        self.bindings = [self.binding, *extra]
        self.sent: list[tuple[float, bytes]] = []
        self.port: MemoryPort = None  # type: ignore[assignment]  # there when the driver has opened it
        self.driver: BenchDriver = None  # type: ignore[assignment]  # there while a story runs

    def fault(self, *texts: str) -> None:
        self.chain.faults.apply(texts)

    def run(self, story, *, opened: bool = True) -> Any:
        """Run a story with the device, opened unless told otherwise."""

        async def main() -> Any:
            kind = type("Driver", (BenchDriver,), {"bench": self})
            self.driver = kind(self.bindings, MANIFESTS, LoopClock(), self)
            try:
                await self.driver.open()
                device = self.driver.devices["alpha.joint"]
                if opened:
                    await device.open()
                return await story(device)
            finally:
                await self.driver.close()

        result = run_jumping(main())
        assert self.crashes == []
        return result


def call(device: Any, instruction: str, *arguments: object) -> Any:
    """An instruction as the guard carries it out."""
    return device.execute(instruction, arguments)
