"""Monitors the links of a host: sends heartbeats, reads TCP counters, detects silent links."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Literal, NamedTuple, Protocol

from lfield.errors import AddressError
from lfield.hybrid_clock import HybridClock
from lfield.net.health.link_heartbeats import Heartbeats
from lfield.net.health.traffic import LinkTraffic, TcpCounts
from lfield.wire.messages import Ping, Pong

#: Silence of a link: none, enough to try another connection in parallel, or enough to close it.
Silence = Literal["", "suspected", "lost"]


class MonitoredLink(Protocol):
    """The part of `lfield.net.transport.Link` that is used here."""

    def send(self, message: Ping | Pong, /) -> None:
        """Queue a message. Raises AddressError on a closed link."""

    def set_round_trip(self, round_trip: float, /) -> None:
        """Set the measured round-trip time in seconds."""

    def counts(self) -> TcpCounts | None:
        """The kernel's counters of the connection."""


class LinkFigures(NamedTuple):
    """Measurements of one link, see `LinkStatus`: seconds, shares from 0 to 1, bytes.

    None if not measured yet or not available from the kernel.
    """

    round_trip: float | None
    loss: float | None
    sent: int | None
    received: int | None


class LinkMonitor:
    """The links of host number `here` of `hosts`; `now` is a monotonic clock, in seconds.

    Heartbeats of hosts carry the timestamps of `hybrid_clock`.
    """

    def __init__(
        self, hosts: Sequence[str], here: int, now: Callable[[], float], hybrid_clock: HybridClock
    ) -> None:
        self._now, self._hybrid_clock = now, hybrid_clock
        self._heartbeats = {host: Heartbeats(first=here < number) for number, host in enumerate(hosts)}
        self._links: dict[str, tuple[MonitoredLink, LinkTraffic]] = {}
        #: The figures of each link at the last reading of its counters, every few seconds.
        self.latest: dict[str, LinkFigures] = {}

    def on_linked(self, host: str, link: MonitoredLink) -> None:
        """A link with a host was made, and replaces an earlier one."""
        self._heartbeats[host].on_link_made(self._now())
        self._links[host] = link, LinkTraffic()

    def on_unlinked(self, host: str) -> None:
        """The link with a host is closed."""
        del self._links[host]
        self.latest.pop(host, None)

    def check(self, host: str, silent: float) -> Silence:
        """Check a link that has been `silent` for that many seconds, and send a heartbeat if due."""
        beats, now = self._heartbeats[host], self._now()
        link, traffic = self._links[host]
        if traffic.is_due(now):
            self.latest[host] = self.figures(host)
        if silent > beats.lost_after(now):
            return "lost"
        if beats.is_due(now, silent):
            with suppress(AddressError):
                link.send(Ping(beats.send(now), self._hybrid_clock.tick(now)))
        return "suspected" if silent > beats.suspect_after(now) else ""

    def on_ping(self, host: str, link: MonitoredLink, ping: Ping) -> None:
        """A heartbeat of a host, or of an observer (''), has arrived."""
        if host:
            self._heartbeats[host].on_ping()
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
        link, traffic = self._links[host]
        traffic.record(link.counts(), self._now())
        counts = traffic.counts
        sent, received = (counts.bytes_sent, counts.bytes_received) if counts is not None else (None, None)
        return LinkFigures(self.round_trip(host), traffic.loss, sent, received)
