"""Scheduling jitter of this computer, and the limit for its bindings. Pure: samples in, figures and sentences
out.

A guard treats its host as dead when the last heartbeat is older than `silence`. The time between two
heartbeats is HEARTBEAT_INTERVAL plus the delay of the host's loop plus the delay of the guard's read; both
run on one computer and may be late at once. A computer with a jitter of L therefore supports a silence of

    HEARTBEAT_INTERVAL + 2 L      if guards have normal priority
    HEARTBEAT_INTERVAL + 1.5 L    if guards have real-time priority

The additional half is a reserve, since the measurement is short.

A larger jitter is refused at startup and logged as a warning later. A jitter of 20 ms supports the smallest
silence, 0.1 s; a jitter of 0.12 s does not.
"""

from __future__ import annotations

import math
from collections import deque

from msgspec import Struct

from lfield.guard.messages import host_silent
from lfield.text import log_messages
from lfield.text.log_messages import LogLine

#: Seconds between two heartbeats.
HEARTBEAT_INTERVAL = 0.05
#: The weight of the host's jitter: guards may also be late, unless they have real-time priority.
NORMAL_FACTOR, REALTIME_FACTOR = 2.0, 1.5
#: The longest silence of a binding, in seconds.
MAX_SILENCE = 10.0
#: Window of the figure in `lfield ps`, and interval between two equal warnings, in seconds.
WINDOW = 60.0
#: Factor by which a jitter must be worse for another warning within the window.
REPEAT_WARNING_FACTOR = 1.5
#: Longest delay of a guard's report of a silence, in seconds.
MAX_REPORT_DELAY = 2.0


class JitterLimit(Struct, frozen=True):
    """The jitter limit of a `silence`; `is_realtime`: its guards have real-time priority. In seconds."""

    silence: float
    is_realtime: bool = False

    @property
    def max_jitter(self) -> float:
        """The largest permitted jitter of the host."""
        return (self.silence - HEARTBEAT_INTERVAL) / self._factor

    @property
    def _factor(self) -> float:
        return REALTIME_FACTOR if self.is_realtime else NORMAL_FACTOR

    def shortest_silence(self, late: float) -> float:
        """The shortest silence for a jitter, in tenths of a second."""
        # A multiple of 0.1 must not be rounded up because of its last bits.
        return max(1, math.ceil(round((HEARTBEAT_INTERVAL + self._factor * late) * 10, 6))) / 10

    def report(self, late: float) -> str:
        """The measurement, for the user who starts a host."""
        if late <= self.max_jitter:
            return (
                f"heartbeats to guards up to {format_jitter(late)} late: fast enough for "
                f"'silence: {self.silence:g}'"
            )
        shortest = self.shortest_silence(late)
        could = (
            f"the shortest possible silence is {shortest:g} s"
            if shortest <= MAX_SILENCE
            else "no silence is long enough"
        )
        return (
            f"'silence: {self.silence:g}' is too short for this computer: heartbeats to guards are up to "
            f"{format_jitter(late)} late, and {could}"
        )

    def remedy(self, late: float) -> str:
        """The remedy for a jitter that is too large."""
        measures = ["reduce the load of this computer"]
        if not self.is_realtime:
            measures.append("give its guards real-time priority (LimitRTPRIO=1, see 'lfield doctor')")
        shortest = self.shortest_silence(late)
        if shortest <= MAX_SILENCE:
            measures.append(
                f"write 'silence: {shortest:g}' if the vehicles may move for so long without their host"
            )
        return " or ".join([", ".join(measures[:-1]), measures[-1]] if len(measures) > 1 else measures)


class JitterMonitor:
    """Jitter of this computer while its host runs."""

    def __init__(self, limit: JitterLimit) -> None:
        self.limit = limit
        #: The maximum since the start.
        self.longest = 0.0
        # Time and jitter of samples within the window, without samples that a later one exceeds.
        self._recent: deque[tuple[float, float]] = deque()
        self._warned_at, self._warned_of = -math.inf, 0.0

    def sample(self, scheduled: float, actual: float) -> LogLine | None:
        """Adds a sample; returns a warning for the log, or None."""
        late = max(0.0, actual - scheduled)
        self.longest = max(self.longest, late)
        while self._recent and self._recent[-1][1] <= late:
            self._recent.pop()
        self._recent.append((actual, late))
        while self._recent[0][0] < actual - WINDOW:
            self._recent.popleft()
        return self._warning(late, actual)

    def max_since(self, when: float) -> float:
        """The maximum since `when`, 0 for none; limited to the window."""
        return next((late for time, late in self._recent if time >= when), 0.0)

    def last_minute(self, now: float) -> float:
        """The maximum of the last minute."""
        return self.max_since(now - WINDOW)

    def explain_silence(self, now: float, due: float) -> str:
        """The reason why a guard has missed the heartbeat that was `due`: this computer is the cause, not the
        vehicle.
        """
        late = max(self.max_since(now - self.limit.silence - MAX_REPORT_DELAY), now - due)
        if late > self.limit.max_jitter:
            return f"this computer was late by {format_jitter(late)}"
        return "this computer was late to wake its guard"

    def _warning(self, late: float, now: float) -> LogLine | None:
        if now - self._warned_at >= WINDOW:
            self._warned_of = 0.0
        if late <= self.limit.max_jitter or late < REPEAT_WARNING_FACTOR * self._warned_of:
            return None
        self._warned_at, self._warned_of = now, late
        limit = format_jitter(self.limit.silence - HEARTBEAT_INTERVAL)
        return log_messages.HEARTBEAT_LATE.line(
            late=format_jitter(late), longest=format_jitter(self.longest), limit=limit
        )


class HeartbeatJitter:
    """Jitter of the heartbeats to one guard: the interval since the last one, less HEARTBEAT_INTERVAL."""

    def __init__(self, lateness: JitterMonitor) -> None:
        self._jitter = lateness
        self._due = math.inf

    def on_heartbeat(self, now: float) -> LogLine | None:
        """A heartbeat is sent; returns a warning for the log, or None."""
        due, self._due = self._due, now + HEARTBEAT_INTERVAL
        return self._jitter.sample(due, now)

    def pause(self) -> None:
        """Marks that no heartbeat is due until the next one is sent."""
        self._due = math.inf

    def explain(self, reason: str, now: float) -> str:
        """The reason why a guard has made a device safe; with the cause if this host was silent."""
        if reason != host_silent(self._jitter.limit.silence):
            return reason
        return f"{reason}, since {self._jitter.explain_silence(now, self._due)}"


def format_jitter(seconds: float) -> str:
    """Formats a jitter for people."""
    return f"{seconds * 1000:.0f} ms" if seconds < 0.1 else f"{seconds:.2f} s"
