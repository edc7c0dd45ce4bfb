"""A bench for the CAN driver: its bus is in memory, and the test plays the device."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import pytest

from lfield.driver import DeviceBinding, DeviceError
from lfield.testing.driver_bench import DriverBench, bind
from lfield_can import PLUGIN
from lfield_can.bus.frames import Frame
from lfield_can.driver import CanDriver


class MemoryBus:
    """Delivers frames in the next turn of the loop. `device` gets each frame that the driver sends."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []
        self.device: Callable[[Frame], None] = lambda frame: None
        self.cut = self.full = False
        self.problem_text = ""

    def join(
        self, endpoint: str, received: Callable[[Frame], None], note: Callable[[str], None], wire_log: Any
    ) -> Any:
        """Use this bus instead of the driver's."""
        self.received = received
        return self

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
            self.loop.call_soon(self._deliver, frame)

    def _deliver(self, frame: Frame) -> None:
        self.device(frame)

    def say(self, identifier: int, data: bytes, *, extended: bool = False) -> None:
        """Send a frame of the device."""
        if not self.cut:
            self.received(Frame(identifier, data, extended))


class CanBench(DriverBench):
    """The driver on a bus in memory."""

    def __init__(
        self, *bindings: DeviceBinding, bus: MemoryBus | None = None, fakes: Sequence[Any] = ()
    ) -> None:
        self.bus = bus or MemoryBus()
        make = partial(CanDriver, make_bus=self.bus.join)
        super().__init__(PLUGIN, *bindings, make=make, fakes=fakes)


@pytest.fixture(scope="session")
def binding() -> Callable[..., DeviceBinding]:
    """A binding with the defaults of its manifest: `binding("CanAxis", options={"node": 5})`."""
    return partial(bind, PLUGIN, agent="winch", field="axis", endpoint="virtual:test")


@pytest.fixture(scope="session")
def bench() -> type[CanBench]:
    return CanBench


@pytest.fixture
def bus() -> MemoryBus:
    return MemoryBus()


@pytest.fixture
def drive(binding: Any) -> Any:
    """A binding of the CiA 402 drive without its endpoint."""

    def make(**changes):
        settings = {"limits": {"speed": 20.0}, "waivers": ["no_homing"], "ttl": 1.0, **changes}
        options = {"protocol": "cia402", "node": 5, "counts": 4096, **settings.pop("options", {})}
        return lambda endpoint: binding("CanAxis", endpoint=endpoint, options=options, **settings)

    return make


@pytest.fixture
def odrive(binding: Any) -> Any:
    """A binding of the ODrive without its endpoint."""

    def make(**changes):
        settings = {
            "limits": {"speed": 20.0},
            "waivers": ["no_homing", "device_watchdog"],
            "ttl": 1.0,
            **changes,
        }
        options = {"protocol": "odrive", "node": 3}
        return lambda endpoint: binding(
            "CanAxis", field="wheel", endpoint=endpoint, options=options, **settings
        )

    return make
