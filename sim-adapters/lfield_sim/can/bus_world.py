"""A bus with its devices over time: the whole simulated device without its adapters. Pure: time is given."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from lfield_sim.can.can_bus import ERROR_BUS_OFF, BusPort, CanBus, CanFrame
from lfield_sim.faults import Faults
from lfield_sim.state_log import Facts

#: Seconds between two steps of the models.
TICK = 0.005
#: A world that was halted for longer does not catch up.
LONGEST_GAP = 0.5
#: Frames of one device that may wait for the bus; more are dropped, as by full controllers.
MAX_WAITING = 1000


class BusDevice(Protocol):
    """A model on the bus. `id` is its name in faults."""

    @property
    def id(self) -> str:
        """The name of the device in faults: a node id, or the name of a DBC file."""

    def power_up(self) -> list[CanFrame]:
        """Powers the device up; returns the frames that it sends."""

    def power_down(self) -> None:
        """Removes the supply: only a brake holds a motor."""

    def on_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Receives a frame; returns the answers."""

    def step(self, dt: float) -> list[CanFrame]:
        """Advances time, at most TICK seconds; returns the frames that the device sends."""

    def facts(self) -> Facts:
        """The log entries of the device."""


class BusWorld:
    """Devices on a bus. `start` is the time when they are powered up."""

    def __init__(
        self,
        devices: Sequence[BusDevice],
        faults: Faults,
        *,
        bitrate: int = 1_000_000,
        data_bitrate: int = 5_000_000,
        start: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.bus = CanBus(faults, bitrate=bitrate, data_bitrate=data_bitrate, seed=seed)
        self._faults, self._now, self._next_tick = faults, start, start + TICK
        self._was_off = False
        self._devices = [_DeviceAtPort(device, self.bus, faults) for device in devices]
        for device in self._devices:
            device.set_power(powered=True, now=start)

    def due(self) -> float:
        """The time when `advance` is next due."""
        return min(self._next_tick, self.bus.due())

    def advance(self, now: float) -> None:
        """Processes all events due by `now`, in order."""
        if now - self._next_tick > LONGEST_GAP:
            self._next_tick = now
        while self.due() <= now:
            self.bus.advance(min(now, self._next_tick))
            if self._next_tick <= now:
                self._tick(self._next_tick)
                self._next_tick += TICK

    def _tick(self, now: float) -> None:
        is_off = bool(self._faults.get("bus_off"))
        if is_off and not self._was_off:
            self.bus.announce(ERROR_BUS_OFF, now)
        self._was_off = is_off
        for device in self._devices:
            device.step(now)


class _DeviceAtPort:
    """A device at its port, powered or not."""

    def __init__(self, device: BusDevice, bus: CanBus, faults: Faults) -> None:
        self._device, self._bus, self._faults = device, bus, faults
        self._port = BusPort(self._on_frame, device.id)
        self._is_powered = False
        bus.attach(self._port)

    def set_power(self, *, powered: bool, now: float) -> None:
        """Switches the power of the device."""
        self._is_powered = powered
        if powered:
            self._send(self._device.power_up(), now)
        else:
            self._device.power_down()

    def step(self, now: float) -> None:
        """Runs one tick of the model."""
        is_silent = bool(self._faults.get("silence", self._device.id))
        if is_silent is self._is_powered:
            self.set_power(powered=not is_silent, now=now)
        frames = self._device.step(TICK)
        if self._is_powered:
            self._send(frames, now)

    def _on_frame(self, frame: CanFrame, now: float) -> None:
        if self._is_powered:
            self._send(self._device.on_frame(frame), now)

    def _send(self, frames: Sequence[CanFrame], now: float) -> None:
        for frame in frames[: max(0, MAX_WAITING - self._port.waiting)]:
            self._bus.send(self._port, frame, now)
