"""The lease of one host: until when it may let coordinators act. Pure.

It holds as long as a majority of the members has acknowledged a heartbeat that was *sent* less than a lease
ago: whatever a member promises to others later, it has not promised before it got that heartbeat. Time is
this host's own, and suspended seconds count. A new process holds no lease.
"""

from __future__ import annotations

import math
from collections import deque

from lfield.quorum.members import Members


class Lease:
    """What the members have acknowledged, of the heartbeats that one life of a host sends."""

    def __init__(self, members: Members) -> None:
        self._members = members
        self._number = 0
        #: The heartbeats that an answer may still be of use to: their numbers, and when they were sent.
        self._sent: deque[tuple[int, float]] = deque()
        #: When the newest heartbeat was sent that each other member has acknowledged.
        self._acknowledged: dict[str, float] = {}
        #: When it ends, in seconds on this host's clock.
        self.until = math.inf if self._alone else -math.inf

    @property
    def _alone(self) -> bool:
        return self._members.is_majority([self._members.here])

    def beat(self, now: float) -> int:
        """The number of a heartbeat that is sent now."""
        while self._sent and self._sent[0][1] <= now - self._members.lease:
            self._sent.popleft()
        self._number += 1
        self._sent.append((self._number, now))
        return self._number

    def acknowledged(self, host: str, number: int) -> None:
        """A member has answered that heartbeat."""
        sent = next((at for known, at in self._sent if known == number), None)
        if sent is None or host not in self._members.others:
            return
        self._acknowledged[host] = max(sent, self._acknowledged.get(host, -math.inf))
        self._count()

    def is_asked(self, since: float) -> bool:
        """Whether a heartbeat was sent after that."""
        return bool(self._sent) and self._sent[-1][1] > since

    def holds(self, now: float) -> bool:
        """Whether coordinators may act here now."""
        return now < self.until

    def _count(self) -> None:
        if self._alone:
            return
        times = sorted(self._acknowledged.values(), reverse=True)
        needed = self._members.majority - self._members.counts_itself
        if len(times) >= needed:
            self.until = times[needed - 1] + self._members.lease
