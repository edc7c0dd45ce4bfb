"""Majority lease of one host: the time until which its coordinators may act. Sans-IO.

The lease holds while a majority of the members has acknowledged a heartbeat *sent* less than one lease ago:
later promises of a member were not made before the member received this heartbeat. Times are those of this
host's clock, which includes suspended time. A new process holds no lease.
"""

from __future__ import annotations

import math
from collections import deque

from lfield.replication.lease.quorum_members import QuorumMembers


class Lease:
    """Heartbeats of one incarnation of a host and their acknowledgements by the members."""

    def __init__(self, members: QuorumMembers) -> None:
        self._members = members
        self._number = 0
        #: The heartbeats whose acknowledgement still matters: number and time of sending.
        self._sent: deque[tuple[int, float]] = deque()
        #: The time of sending of the newest heartbeat that each other member has acknowledged.
        self._acknowledged: dict[str, float] = {}
        #: The time when the lease ends, in seconds on this host's clock.
        self.valid_until = math.inf if self._alone else -math.inf

    @property
    def _alone(self) -> bool:
        return self._members.is_majority([self._members.own_name])

    def next_heartbeat(self, now: float) -> int:
        """The number of a heartbeat that is sent now."""
        while self._sent and self._sent[0][1] <= now - self._members.lease:
            self._sent.popleft()
        self._number += 1
        self._sent.append((self._number, now))
        return self._number

    def on_ack(self, host: str, number: int) -> None:
        """A member has acknowledged the heartbeat with this number."""
        sent = next((at for known, at in self._sent if known == number), None)
        if sent is None or host not in self._members.others:
            return
        self._acknowledged[host] = max(sent, self._acknowledged.get(host, -math.inf))
        self._update()

    def is_requested_since(self, since: float) -> bool:
        """Whether a heartbeat was sent after that time."""
        return bool(self._sent) and self._sent[-1][1] > since

    def holds(self, now: float) -> bool:
        """Whether coordinators on this host may act now."""
        return now < self.valid_until

    def _update(self) -> None:
        if self._alone:
            return
        times = sorted(self._acknowledged.values(), reverse=True)
        needed = self._members.majority - self._members.is_voter
        if len(times) >= needed:
            self.valid_until = times[needed - 1] + self._members.lease
