"""A bus with its devices, moved through time: the whole fake without its doors. Pure: time is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from lfield_sim.can.bus import ERROR_BUS_OFF, Bus, Frame, Port
from lfield_sim.faults import Faults
from lfield_sim.state_log import Facts

#: Between two steps of the models, in seconds.
TICK = 0.005
#: A world that was halted for longer than this does not catch up.
LONGEST_GAP = 0.5
#: Frames of one device that may wait for the bus; more are lost, as when a controller's buffers are full.
MOST_WAITING = 1000


class Device(Protocol):
    """A model on the bus. `id` is what faults call it."""

    @property
    def id(self) -> str:
        """What faults call it: a node id, the name of a DBC file."""

    def power_up(self) -> list[Frame]:
        """Start anew; what it then sends."""

    def power_down(self) -> None:
        """Lose the supply: nothing holds a motor but its brake."""

    def on_frame(self, frame: Frame) -> list[Frame]:
        """Hear a frame; the answers."""

    def step(self, dt: float) -> list[Frame]:
        """Let time pass, at most TICK seconds; what it then sends."""

    def facts(self) -> Facts:
        """What it writes into its log."""


class World:
    """Devices on a bus. `start` is the time at which they get power."""

    def __init__(
        self,
        devices: Sequence[Device],
        faults: Faults,
        *,
        bitrate: int = 1_000_000,
        data_bitrate: int = 5_000_000,
        start: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.bus = Bus(faults, bitrate=bitrate, data_bitrate=data_bitrate, seed=seed)
        self._faults, self._now, self._next_tick = faults, start, start + TICK
        self._was_off = False
        self._places = [_Place(device, self.bus, faults) for device in devices]
        for place in self._places:
            place.power(on=True, now=start)

    def due(self) -> float:
        """When `advance` has the next thing to do."""
        return min(self._next_tick, self.bus.due())

    def advance(self, now: float) -> None:
        """Let everything happen that is due by `now`, in order."""
        if now - self._next_tick > LONGEST_GAP:
            self._next_tick = now
        while self.due() <= now:
            self.bus.advance(min(now, self._next_tick))
            if self._next_tick <= now:
                self._tick(self._next_tick)
                self._next_tick += TICK

    def _tick(self, now: float) -> None:
        off = bool(self._faults.get("bus_off"))
        if off and not self._was_off:
            self.bus.announce(ERROR_BUS_OFF, now)
        self._was_off = off
        for place in self._places:
            place.step(now)


class _Place:
    """A device at its port, with power or without."""

    def __init__(self, device: Device, bus: Bus, faults: Faults) -> None:
        self._device, self._bus, self._faults = device, bus, faults
        self._port = Port(self._hear, device.id)
        self._on = False
        bus.attach(self._port)

    def power(self, *, on: bool, now: float) -> None:
        """Give it power or take it away."""
        self._on = on
        if on:
            self._send(self._device.power_up(), now)
        else:
            self._device.power_down()

    def step(self, now: float) -> None:
        """One tick of the model."""
        silent = bool(self._faults.get("silence", self._device.id))
        if silent is self._on:
            self.power(on=not silent, now=now)
        frames = self._device.step(TICK)
        if self._on:
            self._send(frames, now)

    def _hear(self, frame: Frame, now: float) -> None:
        if self._on:
            self._send(self._device.on_frame(frame), now)

    def _send(self, frames: Sequence[Frame], now: float) -> None:
        for frame in frames[: max(0, MOST_WAITING - self._port.waiting)]:
            self._bus.send(self._port, frame, now)
