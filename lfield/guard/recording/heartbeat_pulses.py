"""A compact encoding of heartbeats: about ten bytes for each, and bit-exact.

Most inputs of a guard are heartbeats and timers without a decision, some 25 a second. They are recorded
together: a time, and for each input the nanoseconds since the previous one, with the nanoseconds for which a
heartbeat was in transit, or TIMER. A time that is not a whole number of nanoseconds, as in virtual time, is
recorded in full instead.
"""

from __future__ import annotations

from collections.abc import Iterator

from lfield.guard.recording.guard_inputs import HostBeat, TimerExpired
from lfield.guard.recording.guard_records import Pulses

#: The maximum number of pulses in one record: half a second of them.
MOST_PULSES = 10
#: The value in place of the transit time, for an expired timer.
TIMER = -1
#: Nanoseconds in a second.
_SECOND = 1e9
#: The largest difference of two times in a record.
_LONGEST = 1 << 62


class PulseCollector:
    """Collects pulses until `record` returns them; `is_full` says that `record` should be called."""

    def __init__(self) -> None:
        self._start, self._last = 0.0, 0
        self._steps: list[int] = []

    @property
    def is_full(self) -> bool:
        """Whether there are MOST_PULSES."""
        return len(self._steps) >= 2 * MOST_PULSES

    def add(self, time: float, event: HostBeat | TimerExpired) -> bool:
        """Adds a pulse; returns whether it could be encoded exactly."""
        now = _exact(time)
        last = self._last if self._steps else now
        if now is None or last is None or not 0 <= now - last < _LONGEST:
            return False
        delay: int | None = TIMER
        if isinstance(event, HostBeat):
            sent = _exact(event.sent)
            delay = None if sent is None or not 0 <= now - sent < _LONGEST else now - sent
        if delay is None:
            return False
        if not self._steps:
            self._start = time
        self._steps += [now - last, delay]
        self._last = now
        return True

    def record(self) -> Pulses | None:
        """The collected pulses; None without any."""
        if not self._steps:
            return None
        steps, self._steps = self._steps, []
        return Pulses(self._start, steps)


def pulses_in(record: Pulses) -> Iterator[tuple[float, HostBeat | TimerExpired]]:
    """The inputs of a record with their times."""
    now = round(record.start * _SECOND)
    for step, delay in zip(record.steps[::2], record.steps[1::2], strict=True):
        now += step
        yield now / _SECOND, TimerExpired() if delay == TIMER else HostBeat((now - delay) / _SECOND)


def _exact(time: float) -> int | None:
    """A time in nanoseconds, None if it is no whole number of nanoseconds."""
    if not abs(time) < _LONGEST / _SECOND:
        return None
    nanoseconds = round(time * _SECOND)
    return nanoseconds if nanoseconds / _SECOND == time else None
