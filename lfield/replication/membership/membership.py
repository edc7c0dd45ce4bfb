"""Gossip failure detector (sans-IO): the time when each host of a team last gave evidence of life.

The detector is idle until a peer is missing. A host that misses a peer sends a probe (host, incarnation,
counter + 10) to its overlay neighbours; each neighbour forwards the data that is new to it. A probed host
emits one heartbeat per second up to that counter, and these spread in the same way. Only a counter that grows
is evidence of life. Repeated gossip therefore never refreshes a dead host, and no clocks are compared.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from typing import Protocol

from lfield.replication.locate.outcomes import UnavailableHosts
from lfield.replication.membership.overlay import Overlay
from lfield.wire.messages import GossipUpdate, LivenessCounter

#: Seconds between two heartbeats of a probed host, and minimum seconds between two gossip messages.
HEARTBEAT_EVERY, GOSSIP_EVERY = 1.0, 0.1
#: A shorter silence is no evidence of failure: probe and heartbeat may each be in transit for this time.
SUSPICION_TIMEOUT = 3.0
#: Heartbeats requested by one probe. When half of them have arrived, the next probe is sent.
HEARTBEAT_CREDIT = 10
#: Incarnations tracked per host. The counter of an older incarnation may count as new once more.
MAX_INCARNATIONS = 64
#: Maximum number of heartbeats, and of probes, in one message. The rest follows in the next message.
MAX_COUNTERS = 64


class LinkContacts(Protocol):
    """The measurements of the transport about the links of this host; times are in seconds of its monotonic
    clock.
    """

    @property
    def down_since(self) -> Mapping[str, float]:
        """The time since when each host has had no link, for hosts without a link."""

    def last_contact_at(self, host: str) -> float | None:
        """The time of the last message from a host; None before the first."""


class HighestCounters:
    """The highest counter of each incarnation of each host, and the last counter that was new."""

    def __init__(self) -> None:
        self._counts: dict[int, dict[int, int]] = {}
        self.newest: dict[int, LivenessCounter] = {}

    def count_of(self, host: int, incarnation: int) -> int:
        """The counter of an incarnation; 0 if unknown."""
        return self._counts.get(host, {}).get(incarnation, 0)

    def update(self, sign: LivenessCounter) -> bool:
        """Record a counter. Returns whether it is new."""
        if sign.count <= self.count_of(sign.host, sign.incarnation):
            return False
        counts = self._counts.setdefault(sign.host, {})
        counts[sign.incarnation] = sign.count
        if len(counts) > MAX_INCARNATIONS:
            del counts[next(iter(counts))]
        self.newest[sign.host] = sign
        return True


class Membership:
    """Liveness of the other hosts, for all parts of one host. Times are in seconds of its monotonic clock.

    `hosts` are the hosts of the deployment, with their `numbers`. `own_number` is this host's number,
    `incarnation` its incarnation, `now` the start time. `neighbours` are the overlay links, which carry the
    gossip; `contacts` are the links as the transport measures them.
    """

    def __init__(
        self,
        hosts: Sequence[str],
        numbers: Mapping[str, int],
        own_number: int,
        incarnation: int,
        now: float,
        neighbours: Overlay,
        contacts: LinkContacts,
    ) -> None:
        self._contacts = contacts
        #: The time of the last message from a host itself; None before the first. Heartbeats that other hosts
        #: pass on do not count: they show that the host is alive, but not that a message can reach it.
        self.last_contact = contacts.last_contact_at
        self._hosts, self._numbers = hosts, numbers
        self._own_number, self._incarnation = own_number, incarnation
        self._neighbours, self.neighbours = neighbours, neighbours.neighbours
        #: The heartbeat counter of this host, and the counter up to which it was probed.
        self._count = self._promised = 0
        self._counters, self._probes = HighestCounters(), HighestCounters()
        #: Numbered updates, the newest last: heartbeats, and probes per incarnation (one must not hide
        #: another). The number up to which each host has received them.
        self._changes: dict[tuple[bool, int, int], int] = {}
        self._number = 0
        self._gossiped_until: dict[str, int] = {}
        #: Hosts that send gossip to this host, because it is their neighbour.
        self._gossipers: set[str] = set()
        #: Probes whose heartbeats have not arrived yet.
        self._owed_counters: dict[str, LivenessCounter] = {}
        #: The time when each host last gave evidence of life, and when it was first missed.
        self._last_evidence: dict[str, float] = {}
        self._since = dict.fromkeys(neighbours.neighbours, now)
        #: Hosts with an open link.
        self.linked: set[str] = set()
        self._started_at, self._next_heartbeat, self._next_gossip_at = now, now, now
        #: Hosts that have certainly ended, and hosts with more than one known incarnation.
        self.ended: set[str] = set()
        self.restarted: set[str] = set()
        #: The last linked incarnation of each host, and the first known one.
        self._incarnations: dict[str, int] = {}
        self._first_incarnations: dict[str, int] = {}
        #: Hosts that did not answer the last cluster query.
        self.suspected: set[str] = set()
        #: The time when `next_gossip` is due; None if it has no recipients.
        self.due: float | None = now if len(hosts) > 2 else None

    @property
    def _others(self) -> list[str]:
        return [host for number, host in enumerate(self._hosts) if number != self._own_number]

    # --- links ----------------------------------------------------------------------------------------

    def is_linked(self, host: str) -> bool:
        """Whether a link to the host is open."""
        return host in self.linked

    @property
    def links(self) -> list[str]:
        """The hosts with an open link, in the order of the deployment."""
        return sorted(self.linked, key=self._numbers.__getitem__)

    @property
    def down_since(self) -> Mapping[str, float]:
        """The time since when each host has had no link, for hosts without a link."""
        return self._contacts.down_since

    def missing_for(self, host: str, now: float) -> float:
        """Seconds without a link to a needed host; 0 with a link, or for a host that is not needed."""
        since = self.down_since.get(host)
        return 0.0 if since is None or host in self.linked else max(0.0, now - since)

    def overlay_links(self, now: float) -> frozenset[str]:
        """The hosts to keep links with, so that gossip reaches the whole team."""
        return self._neighbours.links(now)

    def on_linked(self, host: str, incarnation: int) -> bool:
        """A link opened. Returns whether the host restarted since its last link."""
        self.linked.add(host)
        self._neighbours.on_linked(host)
        self._gossiped_until.pop(host, None)
        self._owed_counters.pop(host, None)
        restarted = self._incarnations.get(host, incarnation) != incarnation
        if restarted:
            self._gossip_restart(host, self._incarnations[host])
        self._incarnations[host] = incarnation
        self._note_incarnation(host, incarnation)
        return restarted

    def on_unlinked(self, host: str, now: float) -> None:
        """A link closed."""
        self.linked.discard(host)
        self._neighbours.on_unlinked(host)
        self._gossipers.discard(host)
        self._last_evidence[host] = now
        self._run_now(now)

    def _gossip_restart(self, host: str, before: int) -> None:
        """Probe the earlier incarnation, so that all hosts learn of it; the later incarnation answers with a
        heartbeat.
        """
        number = self._numbers[host]
        self._forward_probe(LivenessCounter(number, before, self._counters.count_of(number, before) + 1))

    def _note_incarnation(self, host: str, incarnation: int) -> None:
        if self._first_incarnations.setdefault(host, incarnation) != incarnation:
            self.restarted.add(host)

    # --- outgoing gossip ------------------------------------------------------------------------------

    def next_gossip(self, now: float) -> list[tuple[str, GossipUpdate]]:
        """The gossip for each neighbour: the updates that it does not have."""
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_EVERY
            if self._count < self._promised:
                self._count += 1
                self._on_counter(LivenessCounter(self._own_number, self._incarnation, self._count))
            self._probe(self._missing(now))
        listeners = self._gossip_targets() if self._changes else []
        messages = [(host, gossip) for host in listeners if (gossip := self._gossip_for(host))]
        if messages:
            self._next_gossip_at = now + GOSSIP_EVERY
        behind = any(self._gossiped_until.get(host, 0) < self._number for host in listeners)
        self.due = min(self._next_heartbeat, self._next_gossip_at) if behind else self._next_heartbeat
        return messages

    def _gossip_targets(self) -> list[str]:
        targets = self._neighbours.chosen | self._gossipers
        return sorted(targets & self.linked, key=self._numbers.__getitem__)

    def on_gossip(self, host: str, message: GossipUpdate, now: float) -> None:
        """Apply the gossip of another host."""
        self._gossipers.add(host)
        before = self._number
        for question in self._valid_counters(message.probes):
            self._on_probe(question, now)
        for sign in self._valid_counters(message.counters):
            if sign.host != self._own_number and self._on_counter(sign):
                self._last_evidence[self._hosts[sign.host]] = now
        if self._number > before and self.due is not None:
            self.due = min(self.due, max(now, self._next_gossip_at))

    def _valid_counters(self, signs: Iterable[LivenessCounter]) -> list[LivenessCounter]:
        return [sign for sign in signs if sign.host < len(self._hosts)]

    def _gossip_for(self, host: str) -> GossipUpdate | None:
        since = self._gossiped_until.get(host, 0)
        new_keys = []
        for key in reversed(self._changes):
            if self._changes[key] <= since:
                break
            new_keys.append(key)
        part = new_keys[: -MAX_COUNTERS - 1 : -1]
        if not part:
            return None
        self._gossiped_until[host] = self._changes[part[-1]]
        signs = [self._counters.newest[number] for question, number, _ in part if not question]
        questions = [
            LivenessCounter(number, incarnation, self._probes.count_of(number, incarnation))
            for question, number, incarnation in part
            if question
        ]
        return GossipUpdate(signs, questions)

    def _note(self, key: tuple[bool, int, int]) -> None:
        self._number += 1
        self._changes.pop(key, None)
        self._changes[key] = self._number

    def _run_now(self, now: float) -> None:
        """Run the one-second step now."""
        self._next_heartbeat = now
        if self.due is not None:
            self.due = now

    # --- signs and questions --------------------------------------------------------------------------

    def _on_counter(self, sign: LivenessCounter) -> bool:
        """A heartbeat was received or emitted. Returns whether it is new."""
        if not self._counters.update(sign):
            return False
        self._note((False, sign.host, 0))
        host = self._hosts[sign.host]
        self._note_incarnation(host, sign.incarnation)
        question = self._owed_counters.get(host)
        if question and (sign.incarnation != question.incarnation or sign.count >= question.count):
            del self._owed_counters[host]
        return True

    def _on_probe(self, question: LivenessCounter, now: float) -> None:
        """A host is probed."""
        if not self._forward_probe(question):
            return
        host = self._hosts[question.host]
        if question.host == self._own_number:
            is_idle = self._count >= self._promised
            is_own = question.incarnation == self._incarnation
            requested = question.count if is_own else self._count + 1
            self._promised = max(self._promised, min(requested, self._count + HEARTBEAT_CREDIT))
            if is_idle:
                self._run_now(now)
        elif question.incarnation:
            # The probing host knew this incarnation.
            self._last_evidence.setdefault(host, now)

    def _forward_probe(self, question: LivenessCounter) -> bool:
        if not self._probes.update(question):
            return False
        self._note((True, question.host, question.incarnation))
        if question.host == self._own_number:
            return True
        host = self._hosts[question.host]
        if question.incarnation:
            self._note_incarnation(host, question.incarnation)
        if (
            host not in self.linked
            and self._counters.count_of(question.host, question.incarnation) < question.count
        ):
            self._owed_counters[host] = question
        return True

    def _missing(self, now: float) -> list[str]:
        """Neighbours without a link (at first only neighbours that had one), and all hosts that did not
        answer.
        """
        young = now - self._started_at < SUSPICION_TIMEOUT
        neighbours = {host for host in self.neighbours if host in self._incarnations or not young}
        return sorted((neighbours | self.suspected) - self.linked - self.ended, key=self._numbers.__getitem__)

    def _probe(self, hosts: Iterable[str]) -> None:
        for host in hosts:
            number = self._numbers[host]
            newest = self._counters.newest.get(number)
            incarnation = newest.incarnation if newest else self._incarnations.get(host, 0)
            count = newest.count if newest else 0
            if count + HEARTBEAT_CREDIT // 2 >= self._probes.count_of(number, incarnation):
                self._forward_probe(LivenessCounter(number, incarnation, count + HEARTBEAT_CREDIT))

    # --- missing hosts --------------------------------------------------------------------------------

    def is_fully_connected(self, now: float) -> bool:
        """Whether no host is missing and none has restarted, so that every host reports terminations.

        In a team too large for a full mesh, a host that has just started regards no host as missing yet.
        """
        if now - self._started_at < SUSPICION_TIMEOUT and len(self.neighbours) < len(self._hosts) - 1:
            return True
        return (
            not self.restarted
            and self.neighbours <= self.linked
            and all(
                now - self._last_evidence.get(host, self._started_at) < SUSPICION_TIMEOUT
                for host in self._owed_counters
            )
        )

    def unavailable_hosts(
        self, answered: Container[str], now: float, lost_after: float, unmet: float
    ) -> UnavailableHosts:
        """Classify the hosts that did not answer, and probe them.

        A host is unheard when no host has had a heartbeat from it for `lost_after` seconds, or for `unmet`
        seconds if this host never received one.
        """
        silent_for, elsewhere = {}, []
        silent_hosts = [host for host in self._others if host not in answered and host not in self.ended]
        self.suspected = set(silent_hosts) - self.linked
        for host in silent_hosts:
            last = now if host in self.linked else self._last_evidence.get(host)
            silent = now - (self._since.setdefault(host, now) if last is None else last)
            if silent >= (unmet if last is None else max(lost_after, SUSPICION_TIMEOUT)):
                silent_for[host] = silent
            else:
                elsewhere.append(host)
        return UnavailableHosts(self.ended, silent_for, elsewhere, self._incarnations)
