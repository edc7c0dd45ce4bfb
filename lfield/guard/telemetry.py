"""Telemetry to the host: the newest values of each device, at a bounded rate.

`flush_changes` runs before a result, an exception or a latch is sent: a program must never read telemetry
that is older than the exception that it has just caught.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping

from msgspec import Struct, field

from lfield.clock import Clock
from lfield.guard.messages import TelemetrySnapshot
from lfield.manifest import DeviceValue, Observation

#: The maximum number of snapshots per second and device.
RATE = 20.0


class _Latest(Struct):
    """The values published since the last snapshot."""

    values: dict[str, Observation] = field(default_factory=dict)
    last_contact: float = 0.0
    fresh: bool = False
    is_foreign_controlled: bool = False


class Telemetry:
    """Collects values that drivers publish and calls `push` with snapshots, at most RATE per second.

    `is_foreign_controlled` is called for each snapshot. While `is_blocked` (the host does not read), the
    timer pushes no snapshot; the newest values are kept for the next push.
    """

    def __init__(
        self,
        clock: Clock,
        push: Callable[[TelemetrySnapshot], None],
        is_foreign_controlled: Callable[[str], bool] = lambda _: False,
        is_blocked: Callable[[], bool] = lambda: False,
    ) -> None:
        self._clock, self._push = clock, push
        self._is_foreign_controlled, self._is_blocked = is_foreign_controlled, is_blocked
        self._devices: dict[str, _Latest] = {}
        self._timer: asyncio.TimerHandle | None = None

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """Stores new values; an unchanged value also counts as fresh."""
        latest, now = self._fresh(device), self._clock.monotonic()
        for name, value in values.items():
            latest.values[name] = Observation(value, now)

    def on_contact(self, device: str) -> None:
        """Records contact with the device."""
        self._fresh(device).last_contact = self._clock.monotonic()

    def flush(self) -> None:
        """Pushes fresh values now, and a change of foreign control."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for device, latest in self._devices.items():
            is_foreign = self._is_foreign_controlled(device)
            if latest.fresh or is_foreign != latest.is_foreign_controlled:
                self._push(TelemetrySnapshot(device, latest.values, latest.last_contact, is_foreign))
                latest.values, latest.fresh, latest.is_foreign_controlled = {}, False, is_foreign

    def flush_changes(self) -> None:
        """Pushes only if there is more to report than a contact, which alone waits for the timer."""
        known = self._devices.items()
        if any(
            latest.values or self._is_foreign_controlled(device) != latest.is_foreign_controlled
            for device, latest in known
        ):
            self.flush()

    def _fresh(self, device: str) -> _Latest:
        """The record of a device, marked as changed."""
        latest = self._devices.get(device)
        if latest is None:
            latest = self._devices[device] = _Latest(last_contact=self._clock.monotonic())
        if latest.fresh:
            return latest
        latest.fresh = True
        if self._timer is None:
            self._set_timer()
        return latest

    def _set_timer(self) -> None:
        self._timer = asyncio.get_running_loop().call_later(1.0 / RATE, self._on_timer)

    def _on_timer(self) -> None:
        if self._is_blocked():
            self._set_timer()
        else:
            self.flush()
