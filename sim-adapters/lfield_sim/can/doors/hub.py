"""The world in real time as doors see it, and what a door is."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Protocol

from lfield_sim.can.bus import Frame, Port
from lfield_sim.can.world import Device, World
from lfield_sim.faults import Faults

#: Frames of one client that may wait for the bus before no more is read from it.
MOST_WAITING = 64


class Hub:
    """The world on the loop's clock, for doors; wakes when the bus or a model has something to do.

    `moved` is called whenever a device may have changed.
    """

    def __init__(
        self, devices: Sequence[Device], faults: Faults, bitrate: int, moved: Callable[[], None]
    ) -> None:
        self._loop, self._moved = asyncio.get_running_loop(), moved
        self._day = time.time() - self._loop.time()
        self._faults = faults
        self._world = World(devices, faults, bitrate=bitrate, start=self._loop.time())
        self._going_on: list[Callable[[], None]] = []
        self._timer = self._loop.call_soon(self._run)

    def join(self, port: Port) -> None:
        """Let a port take part."""
        self._world.bus.attach(port)

    def leave(self, port: Port) -> None:
        """Let it go."""
        self._world.bus.detach(port)

    def send(self, port: Port, frame: Frame) -> None:
        """Put a frame on the bus now."""
        self._world.bus.send(port, frame, self._loop.time())
        self._wake()

    def when_sent(self, go_on: Callable[[], None]) -> None:
        """Call once after the bus has moved on."""
        self._going_on.append(go_on)

    def seconds(self, time: float) -> float:
        """A time of the bus as a time of day."""
        return self._day + time

    def is_off(self, port: Port) -> bool:
        """Whether a port is bus-off."""
        return bool(self._faults.get("bus_off")) or port.off_until > self._loop.time()

    def stop(self) -> None:
        """End the world."""
        self._timer.cancel()

    def _run(self) -> None:
        self._world.advance(self._loop.time())
        self._moved()
        waiting, self._going_on = self._going_on, []
        for go_on in waiting:
            go_on()
        self._wake()

    def _wake(self) -> None:
        self._timer.cancel()
        self._timer = self._loop.call_at(self._world.due(), self._run)


class Door(Protocol):
    """A way to the bus that can be pulled out and plugged in again (the fault `unplug`)."""

    plugged: bool

    @property
    def endpoint(self) -> str:
        """As a binding has it."""

    def plug(self) -> None:
        """Let clients in."""

    def unplug(self) -> None:
        """Throw clients out."""

    def close(self) -> None:
        """The end."""
