"""Hybrid logical clock: timestamps that order the events of several hosts (Kulkarni and others, 2014). Pure.

A timestamp is an integer: milliseconds since 1970 in the upper bits, a counter in the lower 16. It is at
least the wall-clock time of its host, and greater than every earlier timestamp of this host and than every
timestamp that this host has received. So an effect has a greater timestamp than its cause on another host,
independently of the two clocks. No certificate, lease, time limit or timer uses this clock
(tests/tidy/test_event_timestamps.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable

#: Bits of the counter. A full counter carries into the milliseconds.
COUNTER_BITS = 16
_COUNTER = (1 << COUNTER_BITS) - 1
#: The largest timestamp in a message: the year 6429.
MAX_TIMESTAMP = (1 << 63) - 1
#: The maximum distance, in seconds, of a received timestamp from the host's own wall clock up to which this
#: clock follows it. Clocks that were set by hand or by GPS differ by minutes. A clock with a larger
#: difference was never set, or is faulty: following it would give wrong times to the events of all hosts
#: until the wall clocks reach these times.
MAX_AHEAD = 600.0
#: A change of the wall clock against the monotonic clock that is reported, in seconds. NTP adjusts the rates
#: of both clocks equally, so a smaller change is a rounding error.
MIN_JUMP = 1.0
#: The minimum number of seconds between two reports of jumps.
REPORT_INTERVAL = 60.0


def milliseconds_of(timestamp: int) -> int:
    """The time of a timestamp, in milliseconds since 1970."""
    return timestamp >> COUNTER_BITS


def counter_of(timestamp: int) -> int:
    """The counter of a timestamp."""
    return timestamp & _COUNTER


def timestamp_of(milliseconds: int, counter: int) -> int:
    """A timestamp from its two parts."""
    return (milliseconds << COUNTER_BITS) + counter


class HybridClock:
    """The clock of one host; `now` is its monotonic time and `wall` its wall-clock time, in seconds.

    `on_ahead` gets the name of a host whose timestamps are more than MAX_AHEAD ahead and not followed, and
    the number of seconds: once, until they are well within the bound again. `on_jump` gets the seconds by
    which the wall clock of this host was set, at most once a minute.
    """

    def __init__(
        self,
        now: float,
        wall: float,
        on_ahead: Callable[[str, float], None] = lambda host, seconds: None,
        on_jump: Callable[[float], None] = lambda seconds: None,
    ) -> None:
        self._on_ahead, self._on_jump = on_ahead, on_jump
        #: Wall-clock time minus monotonic time; the same at the last report of a jump, and the time of that
        #: report.
        self._offset = self._known_offset = wall - now
        self._reported_at = -math.inf
        #: The three values above, as a new tuple after each change.
        self.settings = self._offset, self._known_offset, self._reported_at
        #: The hosts that are too far ahead.
        self._reported: set[str] = set()
        #: The greatest timestamp that this clock has given or followed.
        self.last = 0
        self.tick(now)

    @property
    def state(self) -> tuple[int, float, float, float]:
        """The state that determines the next timestamps, for `restore`."""
        return self.last, *self.settings

    def restore(self, state: tuple[int, float, float, float]) -> None:
        """Continue from a `state`."""
        self.last, self._offset, self._known_offset, self._reported_at = state
        self.settings = self._offset, self._known_offset, self._reported_at

    def set_wall_time(self, now: float, wall: float) -> None:
        """Read the wall clock again."""
        self._offset = wall - now
        jump = self._offset - self._known_offset
        is_reported = abs(jump) >= MIN_JUMP and now - self._reported_at >= REPORT_INTERVAL
        if is_reported:
            self._known_offset, self._reported_at = self._offset, now
        self.settings = self._offset, self._known_offset, self._reported_at
        if is_reported:
            self._on_jump(jump)

    def wall_time(self, now: float) -> float:
        """The wall-clock time at `now`, extrapolated from its last reading; in seconds since 1970."""
        return max(0.0, now + self._offset)

    def tick(self, now: float) -> int:
        """The timestamp of an event, or of a message that is sent."""
        self.last = max(self.last + 1, int((now + self._offset) * 1000.0) << COUNTER_BITS)
        return self.last

    def merge(self, host: str, timestamp: int, now: float) -> None:
        """A message of a host has arrived: this event, and every later one, is later than its `timestamp`."""
        own = max(self.last + 1, int((now + self._offset) * 1000.0) << COUNTER_BITS)
        if timestamp < own:
            self.last = own
            if self._reported and timestamp:
                self._reported.discard(host)
            return
        ahead = milliseconds_of(timestamp) / 1000.0 - self._offset - now
        if ahead <= MAX_AHEAD:
            self.last = timestamp + 1
            if ahead <= MAX_AHEAD / 2.0:
                self._reported.discard(host)
            return
        self.last = own
        if host not in self._reported:
            self._reported.add(host)
            self._on_ahead(host, ahead)
