"""What went over one link, and what share of it was lost, from the counters of the kernel. Pure."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

#: Loss is of the last so many seconds, and counters are kept so many seconds apart.
PERIOD, APART = 60.0, 5.0
#: A share of fewer segments than this says nothing.
FEWEST = 10


class Counts(NamedTuple):
    """What the kernel has counted of one connection since it was made.

    Bytes are with what TLS adds and without headers, those sent with the repeated ones. `segments` with data
    were sent, of which so many were `repeated` since an earlier one was lost.
    """

    bytes_sent: int
    bytes_received: int
    segments: int
    repeated: int


class Traffic:
    """The counters of one link as they were read; times are of a monotonic clock, in seconds."""

    def __init__(self) -> None:
        #: The last that was read; None where the kernel does not tell.
        self.counts: Counts | None = None
        self._kept: deque[tuple[float, Counts]] = deque()
        self._due = -math.inf

    def is_due(self, now: float) -> bool:
        """Whether the counters are to be read."""
        return now >= self._due

    def read(self, counts: Counts | None, now: float) -> None:
        """These are the counters now."""
        is_due = self.is_due(now)
        if is_due:
            self._due = now + APART
        if counts is None:
            return
        self.counts = counts
        if is_due:
            self._kept.append((now, counts))
        while len(self._kept) > 1 and self._kept[1][0] <= now - PERIOD:
            self._kept.popleft()

    @property
    def loss(self) -> float | None:
        """The share of the segments with data that were lost on their way there, from 0 to 1, in the last
        minute; None before enough were sent.

        What was sent again and had arrived is not counted where the other end reports it (RFC 2883).
        """
        if self.counts is None:
            return None
        before = self._kept[0][1]
        sent = self.counts.segments - before.segments
        if sent < FEWEST:
            before, sent = Counts(0, 0, 0, 0), self.counts.segments
        if sent < FEWEST:
            return None
        return min(1.0, max(0, self.counts.repeated - before.repeated) / sent)
