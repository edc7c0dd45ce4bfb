"""A bench: the driver and the fake joined in memory, in time that jumps over every wait."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from lfield.driver import DeviceBinding
from lfield.testing.jumping import LoopClock, run_jumping
from lfield_mavlink import PLUGIN
from lfield_mavlink.driver import MavlinkDriver
from lfield_sim.autopilot import KINDS, Autopilot
from lfield_sim.mavlink.protocol import STEP, Faults, MavlinkFake

MANIFEST = PLUGIN.read_manifests()["Mavlink"]


class MemoryLink:
    """Packets handed over in the next turn of the loop."""

    def __init__(self, bench: Bench, on_data: Callable[[bytes], None]) -> None:
        self.bench, self.on_data = bench, on_data

    async def open(self) -> None:
        self.bench.link = self

    def send(self, data: bytes) -> None:
        self.bench.sent.append(data)
        if not self.bench.cut:
            asyncio.get_running_loop().call_soon(self._deliver, data)

    def _deliver(self, data: bytes) -> None:
        for packet in self.bench.fake.receive("driver", data):
            self.on_data(packet)

    def close(self) -> None:
        pass


class BenchDriver(MavlinkDriver):
    bench: Bench

    def _make_link(self):
        return MemoryLink(self.bench, self._received)


class Bench:
    """One fake and one driver for it; what the driver reports is kept."""

    def __init__(
        self, *, kind="copter", faults=None, limits=None, options=None, safe_state="land", **autopilot: Any
    ) -> None:
        self.autopilot = Autopilot(KINDS[kind], **autopilot)
        self.fake = MavlinkFake(self.autopilot, faults=faults or Faults())
        given = {"system": 1, "kind": kind, "connect": 5.0, "tolerance": 0.5, **(options or {})}
        self.binding = DeviceBinding(
            agent="alpha", field="fc", type="Mavlink", driver="mavlink", safe_state=safe_state,
            endpoint="udp:127.0.0.1:1",
            limits=limits or {}, options=given, waivers=["device_watchdog"],
        )  # fmt: skip
        self.sent: list[bytes] = []
        self.link: MemoryLink | None = None
        self.cut = False
        self.values: dict[str, Any] = {}
        self.notes: list[str] = []
        self.crashes: list[str] = []

    # the driver's reports
    def publish(self, device, values):
        self.values.update(values)

    def heard(self, device):
        pass

    def note(self, device, text):
        self.notes.append(text)

    def crashed(self, reason):
        self.crashes.append(reason)

    def run(self, mission: Callable[[Any], Awaitable[Any]], *, opened: bool = True) -> Any:
        """Run a mission with the device, opened unless told otherwise."""

        async def main() -> Any:
            kind = type("Driver", (BenchDriver,), {"bench": self})
            driver = kind([self.binding], {"Mavlink": MANIFEST}, LoopClock(), self)
            flying = asyncio.get_running_loop().create_task(self._fly())
            try:
                await driver.open()
                device = driver.devices["alpha.fc"]
                if opened:
                    await device.open()
                return await mission(device)
            finally:
                flying.cancel()
                await driver.close()

        result = run_jumping(main())
        assert self.crashes == []
        return result

    async def _fly(self) -> None:
        while True:
            await asyncio.sleep(STEP)
            packets = self.fake.advance(STEP)
            if self.link is not None and not self.cut:
                for packet in packets:
                    self.link.on_data(packet)


@pytest.fixture
def bench() -> type[Bench]:
    return Bench


@pytest.fixture
def jumping() -> Callable[[Any], Any]:
    """Run a coroutine in jumping time."""

    def run(work: Any) -> Any:
        return run_jumping(work)

    return run
