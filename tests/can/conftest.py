"""A bench for the CAN driver: a bus in memory, in jumping time or, where vendor threads run, in real time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from lfield.clock import SystemClock
from lfield.driver import DeviceBinding
from lfield.errors import DeviceError
from lfield.simulate.time import LoopClock, run_jumping
from lfield.testing.reports import KeptReports
from lfield_can import PLUGIN
from lfield_can.driver import CanDriver
from lfield_can.frames import Frame

MANIFESTS = PLUGIN.read_manifests()


def make_binding(
    type_name: str, *, field: str = "axis", endpoint: str = "virtual:test", **given: Any
) -> DeviceBinding:
    """A binding with the defaults of its manifest."""
    manifest = MANIFESTS[type_name]
    options = {o.name: o.default for o in manifest.options if o.default is not None}
    return DeviceBinding(
        agent="winch", field=field, type=type_name, driver="can", endpoint=endpoint,
        safe_state=given.get("safe_state", manifest.default_safe_state),
        ttl=given.get("ttl", 0.5),
        limits=given.get("limits", {}),
        options={**options, **given.get("options", {})},
        waivers=given.get("waivers", []),
    )  # fmt: skip


class MemoryBus:
    """Frames handed over in the next turn of the loop. `device` gets each one that the driver sends."""

    def __init__(self, received: Callable[[Frame], None]) -> None:
        self.received = received
        self.sent: list[Frame] = []
        self.device: Callable[[Frame], None] = lambda frame: None
        self.cut = self.full = False

    async def open(self) -> None:
        self.loop = asyncio.get_running_loop()

    async def close(self) -> None:
        pass

    async def send(self, frame: Frame) -> None:
        if self.full:
            raise DeviceError("bus", "a frame could not be sent: its buffer is full")
        self.post(frame)

    def post(self, frame: Frame) -> None:
        self.sent.append(frame)
        if not self.cut:
            self.loop.call_soon_threadsafe(self.device, frame)

    def say(self, identifier: int, data: bytes, *, extended: bool = False) -> None:
        """A frame from the device."""
        if not self.cut:
            self.received(Frame(identifier, data, extended))


class Bench(KeptReports):
    """The driver on a bus in memory."""

    def __init__(self, *bindings: DeviceBinding) -> None:
        super().__init__()
        self.bindings = bindings
        bench = self

        class MemoryDriver(CanDriver):
            def _make_bus(self, endpoint, note):
                bench.bus = MemoryBus(self._received)
                return bench.bus

        self.kind = MemoryDriver

    async def _main(self, mission: Callable[..., Awaitable[Any]], clock: Any, opened: bool) -> Any:
        driver = self.kind(list(self.bindings), MANIFESTS, clock, self)
        self.driver = driver
        try:
            await driver.open()
            devices = list(driver.devices.values())
            if opened:
                await asyncio.gather(*(device.open() for device in devices))
            return await mission(*devices)
        finally:
            await driver.close()

    def run(self, mission: Callable[..., Awaitable[Any]], *, opened: bool = True) -> Any:
        """Run a mission in jumping time."""
        result = run_jumping(self._main(mission, LoopClock(), opened))
        assert self.crashes == []
        return result

    def run_real(self, mission: Callable[..., Awaitable[Any]], *, opened: bool = True) -> Any:
        """Run a mission in real time, since a vendor library has threads."""
        result = asyncio.run(self._main(mission, SystemClock(), opened))
        assert self.crashes == []
        return result


@pytest.fixture(scope="session")
def binding() -> Callable[..., DeviceBinding]:
    return make_binding


@pytest.fixture(scope="session")
def bench() -> type[Bench]:
    return Bench
