"""Monitors the links of a host: sends heartbeats, reads TCP counters, detects silent links."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Literal, NamedTuple, Protocol

from lfield.errors import AddressError
from lfield.hybrid_clock import HybridClock
from lfield.net.coding.traffic_kinds import TrafficBytes
from lfield.net.health.link_heartbeats import IDLE_PING_EVERY, Heartbeats
from lfield.net.health.traffic import LinkTraffic, TcpCounts
from lfield.wire.messages import Ping, Pong

#: Seconds without work after which a link is idle.
IDLE_AFTER = 10.0

#: Silence of a link: none, enough to try another connection in parallel, or enough to close it.
Silence = Literal["", "suspected", "lost"]


class MonitoredLink(Protocol):
    """The part of `lfield.net.transport.Link` that is used here."""

    @property
    def work(self) -> int:
        """The number of transfers and messages sent and received, without background reports."""

    @property
    def traffic(self) -> TrafficBytes:
        """The bytes sent and received, by kind."""

    def send(self, message: Ping | Pong, /) -> None:
        """Queue a message. Raises AddressError on a closed link."""

    def set_round_trip(self, round_trip: float, /) -> None:
        """Set the measured round-trip time in seconds."""

    def on_idle(self) -> None:
        """The link has been idle since the last call."""

    def counts(self) -> TcpCounts | None:
        """The kernel's counters of the connection."""


class LinkFigures(NamedTuple):
    """Measurements of one link, see `LinkStatus`: seconds, shares from 0 to 1, bytes; bytes by kind.

    None if not measured yet or not available from the kernel.
    """

    round_trip: float | None
    loss: float | None
    sent: int | None
    received: int | None
    kinds: dict[str, int]


class LinkActivity:
    """The times when a link last carried work, and last began to after an idle period, in seconds."""

    def __init__(self, now: float) -> None:
        self._work, self._worked_at, self._busy_since = -1, now, now

    def is_idle(self, now: float) -> bool:
        """Whether the link was idle at the last update."""
        return now - self._worked_at > IDLE_AFTER

    def update(self, work: int, now: float) -> None:
        """Record the count of work at this time."""
        if work == self._work:
            return
        if self.is_idle(now):
            self._busy_since = now
        self._work, self._worked_at = work, now

    def expected_silence(self, silent: float, now: float) -> float:
        """The silence since heartbeats have become frequent."""
        return silent if self.is_idle(now) else min(silent, now - self._busy_since)


class LinkMonitor:
    """The links of host number `own_number`; `hosts` are all hosts with their numbers, and `now` is a
    monotonic clock, in seconds.

    Heartbeats of hosts carry the timestamps of `hybrid_clock`; heartbeats of idle links are `idle_interval`
    seconds apart.
    """

    def __init__(
        self,
        hosts: Mapping[str, int],
        own_number: int,
        now: Callable[[], float],
        hybrid_clock: HybridClock,
        idle_interval: float = IDLE_PING_EVERY,
    ) -> None:
        self._now, self._hybrid_clock = now, hybrid_clock
        self._hosts, self._own_number, self._idle_interval = hosts, own_number, idle_interval
        #: The heartbeats of each host that has had a link.
        self._heartbeats: dict[str, Heartbeats] = {}
        self._links: dict[str, tuple[MonitoredLink, LinkTraffic, LinkActivity]] = {}
        #: The bytes exchanged with all observers.
        self.observers = TrafficBytes()
        #: The figures of each link at the last reading of its counters, every few seconds.
        self.latest: dict[str, LinkFigures] = {}

    def on_linked(self, host: str, link: MonitoredLink) -> None:
        """A link with a host was made, and replaces an earlier one."""
        self._heartbeats_of(host).on_link_made(self._now())
        self._links[host] = link, LinkTraffic(), LinkActivity(self._now())

    def _heartbeats_of(self, host: str) -> Heartbeats:
        if (found := self._heartbeats.get(host)) is None:
            first = self._own_number < self._hosts[host]
            found = self._heartbeats[host] = Heartbeats(first=first, idle_interval=self._idle_interval)
        return found

    def on_unlinked(self, host: str) -> None:
        """The link with a host is closed."""
        del self._links[host]
        self.latest.pop(host, None)

    def check(self, host: str, silent: float) -> Silence:
        """Check a link that has been silent for `silent` seconds, and send a heartbeat if due."""
        beats, now = self._heartbeats[host], self._now()
        link, traffic, activity = self._links[host]
        if traffic.is_due(now):
            self.latest[host] = self.figures(host)
        activity.update(link.work, now)
        silent, is_idle = activity.expected_silence(silent, now), activity.is_idle(now)
        if is_idle:
            link.on_idle()
        if silent > beats.lost_after(now, is_idle=is_idle):
            return "lost"
        if beats.is_due(now, silent, is_idle=is_idle):
            with suppress(AddressError):
                link.send(Ping(beats.send(now), self._hybrid_clock.tick(now)))
        return "suspected" if silent > beats.suspect_after(now, is_idle=is_idle) else ""

    def on_ping(self, host: str, link: MonitoredLink, ping: Ping) -> None:
        """A heartbeat of a host, or of an observer (''), has arrived."""
        if host:
            self._heartbeats_of(host).on_ping()
            self._hybrid_clock.merge(host, ping.stamp, self._now())
        link.send(Pong(ping.token))

    def on_pong(self, host: str, pong: Pong) -> None:
        """An answer to a heartbeat has arrived."""
        beats = self._heartbeats.get(host)
        if beats is None or host not in self._links:
            return
        beats.on_pong(pong.token, self._now())
        if beats.round_trip.mean is not None:
            self._links[host][0].set_round_trip(beats.round_trip.mean)

    def round_trip(self, host: str) -> float | None:
        """The smoothed round-trip time of a link in seconds; None if unknown."""
        return self._heartbeats[host].round_trip.mean if host in self._links else None

    def answer_timeout(self, host: str) -> float | None:
        """Seconds within which a linked host answers; None if unknown."""
        return self._heartbeats[host].round_trip.bound if host in self._links else None

    def figures(self, host: str) -> LinkFigures:
        """The current measurements of the link with a host."""
        link, traffic, _ = self._links[host]
        traffic.record(link.counts(), self._now())
        counts = traffic.counts
        sent, received = (counts.bytes_sent, counts.bytes_received) if counts is not None else (None, None)
        return LinkFigures(self.round_trip(host), traffic.loss, sent, received, link.traffic.by_name())
