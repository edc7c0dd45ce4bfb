"""The bus in real time, and the interface of its adapters."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from lfield_sim.can.bus_world import BusDevice, BusWorld
from lfield_sim.can.can_bus import BusPort, CanFrame
from lfield_sim.faults import Faults

#: Frames of one client that may wait for the bus before reading from it pauses.
MAX_WAITING = 64


class BusHub:
    """The bus world on the loop's clock; wakes when the bus or a model is due.

    `on_change` is called whenever a device may have changed.
    """

    def __init__(
        self, devices: Sequence[BusDevice], faults: Faults, bitrate: int, on_change: Callable[[], None]
    ) -> None:
        self._loop, self._on_change = asyncio.get_running_loop(), on_change
        self._epoch_offset = time.time() - self._loop.time()
        self._faults = faults
        self._world = BusWorld(devices, faults, bitrate=bitrate, start=self._loop.time())
        self._callbacks: list[Callable[[], None]] = []
        self._timer = self._loop.call_soon(self._run)

    def join(self, port: BusPort) -> None:
        """Attaches a port."""
        self._world.bus.attach(port)

    def leave(self, port: BusPort) -> None:
        """Detaches a port."""
        self._world.bus.detach(port)

    def send(self, port: BusPort, frame: CanFrame) -> None:
        """Sends a frame on the bus now."""
        self._world.bus.send(port, frame, self._loop.time())
        self._wake()

    def when_sent(self, callback: Callable[[], None]) -> None:
        """Calls `callback` once after the bus has advanced."""
        self._callbacks.append(callback)

    def seconds(self, time: float) -> float:
        """Converts a bus time to a time of day."""
        return self._epoch_offset + time

    def is_off(self, port: BusPort) -> bool:
        """Whether a port is bus-off."""
        return bool(self._faults.get("bus_off")) or port.off_until > self._loop.time()

    def stop(self) -> None:
        """Stops the world."""
        self._timer.cancel()

    def _run(self) -> None:
        self._world.advance(self._loop.time())
        self._on_change()
        callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            callback()
        self._wake()

    def _wake(self) -> None:
        self._timer.cancel()
        self._timer = self._loop.call_at(self._world.due(), self._run)


class BusAdapter(Protocol):
    """Access to the bus that can be unplugged and plugged in again (the fault `unplug`)."""

    plugged: bool

    @property
    def endpoint(self) -> str:
        """The endpoint of the adapter, as in a binding."""

    def plug(self) -> None:
        """Accepts clients."""

    def unplug(self) -> None:
        """Disconnects clients."""

    def close(self) -> None:
        """Closes the adapter."""
