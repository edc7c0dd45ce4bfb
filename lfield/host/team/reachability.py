"""Reachability of hosts: the time for which a coordinator waits for a host without a link; it does not wait
for a lost host. Sans-IO.

A coordinator under a time limit is sent over a link only if a message has just arrived from the other host,
any other coordinator if a message arrived within 2 s. A coordinator sent to a silent host would be in doubt
during the silence, even beyond the limit. The host is probed first, and until it answers the coordinator can
still continue where it is.

A host that was linked has `unreachable_after` from the end of its link, not from the call. A call after half
of that does not wait: the host is regarded as lost until it is linked again. A host that was never linked may
just be starting, so it has the whole time.
"""

from __future__ import annotations

import math

from lfield.host.context import HostContext, Part
from lfield.net.health.link_heartbeats import IDLE_PING_EVERY
from lfield.replication.membership.membership import Membership
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.effects import Send
from lfield.wire.messages import QUESTION, GossipUpdate, Ping

#: The fraction of `unreachable_after` after which an unlinked host counts as lost for new calls.
LOST_FRACTION = 0.5
#: Seconds of silence of a linked host, beyond the time of an answer, after which only a coordinator that must
#: move is sent there.
SILENCE_TIMEOUT = 2.0
#: A host from which a message arrived within this number of seconds is not probed: with a smaller number, a
#: hop under a time limit takes one more round trip.
FRESH_FOR = 0.1
#: Seconds for which a coordinator over its time limit waits for the answer to a probe: the minimum, and the
#: maximum for slow answers.
ANSWER_GRACE, MAX_ANSWER_GRACE = 0.3, 2.0


class Reachability(Part):
    """The liveness of other hosts as known to one host, which sends gossip and probes."""

    def __init__(self, context: HostContext, membership: Membership, mobility: Mobility) -> None:
        self._environment, self._membership, self._clock = context.environment, membership, context.clock
        self._unreachable_after, self._mobility = context.unreachable_after, mobility
        self._out, self._hosts = context.effects.append, context.team.hosts
        self.due = membership.due
        self.handles = {GossipUpdate: self._on_gossip}
        #: The time when each host was last probed.
        self._probed_at: dict[str, float] = {}

    def _on_gossip(self, host: str, message: GossipUpdate) -> None:
        self._membership.on_gossip(host, message, self._clock.monotonic())
        self.due = self._membership.due

    def on_link_opened(self, host: str, incarnation: int) -> bool:
        """A link with a host opened; returns whether the host restarted since the last one."""
        restarted = self._membership.on_linked(host, incarnation)
        self.due = self._membership.due
        return restarted

    def on_link_closed(self, host: str) -> None:
        """The last link with a host closed."""
        self._membership.on_unlinked(host, self._clock.monotonic())
        self.due = self._membership.due

    def on_tick(self, now: float) -> None:
        """Send pending gossip to the neighbours."""
        for host, gossip in self._membership.next_gossip(now):
            self._out(Send(host, gossip))
        self.due = self._membership.due

    def is_linked(self, host: str) -> bool:
        """Whether a host is linked, and therefore neither absent nor lost."""
        return self._membership.is_linked(host)

    def is_silent(self, host: str) -> bool:
        """Whether no message has arrived for a while, or a probe remains unanswered."""
        last_contact = self._membership.last_contact(host)
        if last_contact is None or not self._membership.is_linked(host):
            return False
        now = self._clock.monotonic()
        answer = self._environment.answer_timeout(host) or 0.0
        bound = IDLE_PING_EVERY + SILENCE_TIMEOUT + answer
        silent = host in self._membership.neighbours and now - last_contact > bound
        grace = min(MAX_ANSWER_GRACE, max(ANSWER_GRACE, answer))
        return silent or (self._is_overdue(host, last_contact) and now >= self._probed_at[host] + grace)

    def request_heartbeat(self, host: str, within: float = FRESH_FOR) -> None:
        """Probe a linked host, unless a probe is under way, or a message arrived within `within` seconds, or
        within 0.1 s for a repeated call.
        """
        last_contact, now = self._membership.last_contact(host), self._clock.monotonic()
        if (
            last_contact is None
            or not self._membership.is_linked(host)
            or now - last_contact <= min(within, FRESH_FOR)
        ):
            return
        if not self._is_overdue(host, last_contact) and self._mobility.needs_probe(host):
            self._probed_at[host] = now
            self._out(Send(host, Ping(QUESTION)))

    def is_stale(self, host: str) -> bool:
        """Whether no message has arrived from a linked host for longer than the heartbeat interval of a busy
        link.
        """
        last_contact = self._membership.last_contact(host)
        return last_contact is not None and self._clock.monotonic() - last_contact > SILENCE_TIMEOUT

    def contact_age(self, host: str) -> float:
        """Seconds since the last message from a host; infinite without a link."""
        last_contact = self._membership.last_contact(host) if self._membership.is_linked(host) else None
        return math.inf if last_contact is None else self._clock.monotonic() - last_contact

    def transit_time(self, host: str) -> float:
        """The one-way transit time of a message from or to a linked host, in seconds; 0 if unknown."""
        return (self._environment.round_trip(host) or 0.0) / 2.0

    def arrival_time(self, host: str) -> float:
        """The expected arrival time of a coordinator that leaves now for a linked host, in seconds; 0 for
        others.

        Includes a probe and its answer where one is due.
        """
        last_contact = self._membership.last_contact(host)
        if last_contact is None or not self._membership.is_linked(host):
            return 0.0
        asks = self._clock.monotonic() - last_contact > FRESH_FOR
        return self.transit_time(host) * (3.0 if asks else 1.0)

    def is_heartbeat_pending(self, host: str) -> bool:
        """Whether the answer of a linked host to a probe is awaited."""
        last_contact = self._membership.last_contact(host)
        if last_contact is None or not self._membership.is_linked(host):
            return False
        return self._is_overdue(host, last_contact) and not self.is_silent(host)

    def _is_overdue(self, host: str, last_contact: float) -> bool:
        return last_contact <= self._probed_at.get(host, -math.inf)

    def down_for(self, host: str) -> float:
        """The seconds for which a formerly linked host has had no link; 0 for one never linked, or linked
        now.
        """
        if self._membership.last_contact(host) is None:
            return 0.0
        return self._membership.missing_for(host, self._clock.monotonic())

    def lost_reason(self, host: str) -> str:
        """The reason why a call need not wait for a host, '' if it may be reached in time."""
        if self._membership.is_linked(host):
            return ""
        if host in self._membership.ended:
            return f"{host} could not be reached: it has ended"
        is_met = self._membership.last_contact(host) is not None
        missing = self._membership.missing_for(host, self._clock.monotonic())
        if missing and missing >= (LOST_FRACTION if is_met else 1.0) * self._unreachable_after:
            seconds = f"{missing:.{0 if missing >= 10 else 1}f} s"
            return f"{host} could not be reached: there has been no link for {seconds}; is it up?"
        return ""
