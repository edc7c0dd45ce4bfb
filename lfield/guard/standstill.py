"""Tracks which devices have come to rest in their safe states, and when a stop is over.

A confirmed safe state is only the beginning: a landing vehicle is still in the air. A latched device is
checked until it is at rest. A stop is over when every device was confirmed at rest, or its time is over, or
the operator does not wait; the state of the host has no influence. A muted bus cannot be observed, so its
stop ends with the safe states.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec import Struct

#: Seconds between two checks of a device, and between two progress reports.
CHECK_EVERY, REPORT_EVERY = 0.25, 0.5

#: The condition of a device that was not open in time, and of a device whose safe state was only commanded.
UNFINISHED = "opening was not complete"
UNCONFIRMED = "its safe state was not confirmed"


class Settling(Struct):
    """A device: its time to come to rest in seconds, and its condition.

    `confirmed_at` is None before its safe state was confirmed, `moving` before the first check in this state.
    `reported` is the last report to the host.
    """

    bound: float
    confirmed_at: float | None = None
    moving: str | None = None
    check_at: float | None = None
    reported: str | None = None
    reported_at: float = 0.0


class StandstillState(Struct, frozen=True):
    """The data that a Standstill stores between two events."""

    devices: dict[str, Settling]
    stopped_at: float | None
    is_host_gone: bool
    muted: bool
    is_skipped: bool


class Standstill:
    """The progress of a guard's devices to rest; `within` is the time of each to come to rest, in seconds."""

    def __init__(self, within: Mapping[str, float]) -> None:
        self._devices = {name: Settling(seconds) for name, seconds in within.items()}
        self._stopped_at: float | None = None
        self._is_host_gone = self._muted = self._is_skipped = False

    @property
    def state(self) -> StandstillState:
        """The present state, which the next event changes."""
        return StandstillState(
            self._devices, self._stopped_at, self._is_host_gone, self._muted, self._is_skipped
        )

    def restore(self, state: StandstillState) -> None:
        """Continues from a state."""
        self._devices, self._stopped_at = state.devices, state.stopped_at
        self._is_host_gone, self._muted, self._is_skipped = state.is_host_gone, state.muted, state.is_skipped

    # --- events ---------------------------------------------------------------------------------------

    def on_latched_or_free(self, name: str) -> None:
        """The device enters its safe state, or is free: its condition is unknown."""
        settling = self._devices[name]
        settling.confirmed_at, settling.moving, settling.check_at, settling.reported = None, None, None, None

    def on_confirmed(self, name: str, now: float) -> None:
        """The safe state of a device is confirmed."""
        settling = self._devices[name]
        settling.confirmed_at, settling.check_at = now, now

    def on_motion_report(self, name: str, moving: str, now: float) -> bool:
        """Records how a device still moves, '' at rest; returns whether the host needs a report."""
        settling = self._devices[name]
        if settling.confirmed_at is None:
            return False
        settling.moving = moving
        due = settling.reported is None or not moving or now >= settling.reported_at + REPORT_EVERY
        if moving == settling.reported or not due:
            return False
        settling.reported, settling.reported_at = moving, now
        return True

    def on_stop(self, now: float) -> None:
        """The host stops."""
        if self._stopped_at is None:
            self._stopped_at = now

    def on_host_gone(self) -> None:
        self._is_host_gone = True

    def on_muted(self, muted: bool) -> None:
        """The bus was muted or not: devices on a muted bus may stop sending."""
        self._muted = muted

    def skip_wait(self) -> None:
        """The operator does not wait any longer."""
        self._is_skipped = True

    # --- questions ------------------------------------------------------------------------------------

    def due_checks(self, now: float) -> list[str]:
        """The devices to be checked now; each is due again after CHECK_EVERY."""
        due = [
            name
            for name, settling in self._devices.items()
            if settling.check_at is not None and now >= settling.check_at
        ]
        for name in due:
            self._devices[name].check_at = now + CHECK_EVERY
        return due

    def is_over(self, now: float) -> bool:
        """Whether the stop is over."""
        if self._stopped_at is None:
            return False
        return self._is_skipped or all(self._is_settled(settling, now) for settling in self._devices.values())

    def under_way_until(self) -> float:
        """The last time limit of the confirmed devices not at rest; minus infinity without any."""
        ends = (
            settling.confirmed_at + settling.bound
            for settling in self._devices.values()
            if settling.confirmed_at is not None and settling.moving != ""
        )
        return max(ends, default=-math.inf)

    def unsafe(self) -> dict[str, str]:
        """The devices that were not confirmed at rest in their safe states, with their last known
        condition.
        """
        found = {}
        for name, settling in self._devices.items():
            if settling.confirmed_at is None:
                found[name] = UNCONFIRMED
            elif not self._is_at_rest(settling):
                found[name] = f"it is in its safe state and not at rest: {settling.moving or 'not checked'}"
        return found

    def due(self) -> float | None:
        """The time when the next action is due, on the clock of the events."""
        times = [settling.check_at for settling in self._devices.values() if settling.check_at is not None]
        if self._stopped_at is not None:
            waited = [settling.bound for settling in self._devices.values() if not self._is_at_rest(settling)]
            times += [self._stopped_at + max(waited)] if waited else []
        return min(times, default=None)

    def _is_at_rest(self, settling: Settling) -> bool:
        return settling.confirmed_at is not None and (
            settling.moving == "" or (self._is_host_gone and self._muted)
        )

    def _is_settled(self, settling: Settling, now: float) -> bool:
        assert self._stopped_at is not None
        return self._is_at_rest(settling) or now >= self._stopped_at + settling.bound
