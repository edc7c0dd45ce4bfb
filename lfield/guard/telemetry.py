"""Telemetry on its way to the host: the newest values of each device, pushed at a bounded rate.

Before a result, an exception or a latch goes out, `flush_changes` pushes what was published until then: a
program must never read telemetry that is older than the exception it has just caught.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from lfield.clock import Clock
from lfield.guard.messages import Snapshot
from lfield.manifest import DeviceValue, Observation

#: At most so many snapshots per second and device.
RATE = 20.0


@dataclass(slots=True)
class _Latest:
    """What has been published since the last snapshot."""

    values: dict[str, Observation] = field(default_factory=dict)
    heard: float = 0.0
    fresh: bool = False
    taken: bool = False


class Telemetry:
    """Collects what drivers publish and calls `push` with snapshots, at RATE at most.

    `taken` is asked for each whether somebody else has the device. While `is_blocked`, since the host does
    not read, nothing is pushed by the timer; the newest values are kept for the next push.
    """

    def __init__(
        self,
        clock: Clock,
        push: Callable[[Snapshot], None],
        taken: Callable[[str], bool] = lambda _: False,
        is_blocked: Callable[[], bool] = lambda: False,
    ) -> None:
        self._clock, self._push, self._taken, self._is_blocked = clock, push, taken, is_blocked
        self._devices: dict[str, _Latest] = {}
        self._timer: asyncio.TimerHandle | None = None

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """New values, true now; a value that did not change is fresh all the same."""
        latest, now = self._fresh(device), self._clock.monotonic()
        for name, value in values.items():
            latest.values[name] = Observation(value, now)

    def heard(self, device: str) -> None:
        """The device has shown that it is alive."""
        self._fresh(device).heard = self._clock.monotonic()

    def flush(self) -> None:
        """Push what is fresh, now; also that a device is in other hands than was told before."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for device, latest in self._devices.items():
            taken = self._taken(device)
            if latest.fresh or taken != latest.taken:
                self._push(Snapshot(device, latest.values, latest.heard, taken))
                latest.values, latest.fresh, latest.taken = {}, False, taken

    def flush_changes(self) -> None:
        """The same, if there is more to tell than that devices are alive: that can wait for its turn."""
        known = self._devices.items()
        if any(latest.values or self._taken(device) != latest.taken for device, latest in known):
            self.flush()

    def _fresh(self, device: str) -> _Latest:
        """The record of a device, now with something to push."""
        latest = self._devices.get(device)
        if latest is None:
            latest = self._devices[device] = _Latest(heard=self._clock.monotonic())
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
