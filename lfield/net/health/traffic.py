"""Traffic and loss rate of one link, from the kernel's counters. Sans-IO."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

#: Window of the loss rate in seconds, and seconds between stored counters.
PERIOD, SAMPLE_EVERY = 60.0, 5.0
#: Minimum number of segments for a loss rate.
MIN_SEGMENTS = 10


class TcpCounts(NamedTuple):
    """The kernel's counters of one connection.

    Bytes include TLS overhead and retransmissions, but no headers. `segments`: data segments sent, of which
    `repeated` were retransmissions.
    """

    bytes_sent: int
    bytes_received: int
    segments: int
    repeated: int


class Delivery(NamedTuple):
    """The data that a connection has delivered, as counted by the kernel or the numbered stream.

    `acked`: bytes or packets that the peer has acknowledged. `is_pending`: whether data that the peer may
    receive awaits an acknowledgement. `round_trip` and `variation`: the smoothed round trip and its
    variation, in seconds.
    """

    acked: int
    is_pending: bool
    round_trip: float
    variation: float


class LinkTraffic:
    """The counters of one link over time; times are monotonic seconds."""

    def __init__(self) -> None:
        #: The last counters; None if the kernel provides none.
        self.counts: TcpCounts | None = None
        self._samples: deque[tuple[float, TcpCounts]] = deque()
        self._due = -math.inf

    def is_due(self, now: float) -> bool:
        """Whether the counters are due for reading."""
        return now >= self._due

    def record(self, counts: TcpCounts | None, now: float) -> None:
        """Store the present counters."""
        is_due = self.is_due(now)
        if is_due:
            self._due = now + SAMPLE_EVERY
        if counts is None:
            return
        self.counts = counts
        if is_due:
            self._samples.append((now, counts))
        while len(self._samples) > 1 and self._samples[1][0] <= now - PERIOD:
            self._samples.popleft()

    @property
    def loss(self) -> float | None:
        """The share of data segments lost in transit in the last minute, from 0 to 1; None before enough
        segments were sent.

        Spurious retransmissions are excluded where the peer reports them (RFC 2883).
        """
        if self.counts is None:
            return None
        before = self._samples[0][1]
        sent = self.counts.segments - before.segments
        if sent < MIN_SEGMENTS:
            before, sent = TcpCounts(0, 0, 0, 0), self.counts.segments
        if sent < MIN_SEGMENTS:
            return None
        return min(1.0, max(0, self.counts.repeated - before.repeated) / sent)
