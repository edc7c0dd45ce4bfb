"""Watches the links of a host: sends heartbeats, reads counters, says which link has been silent for long."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Literal, NamedTuple, Protocol

from lfield.errors import AddressError
from lfield.net.health.heartbeats import Heartbeats
from lfield.net.health.traffic import Counts, Traffic
from lfield.wire.messages import Ping, Pong

#: How silent a link is: not, or so that another connection is tried beside it, or so that it is given up.
Silence = Literal["", "suspected", "lost"]


class Link(Protocol):
    """As much of a `lfield.net.transport.Link` as is needed here."""

    def send(self, message: Ping | Pong, /) -> None:
        """Queue a message. Raises AddressError on a closed link."""

    def expect(self, round_trip: float, /) -> None:
        """Answers take so many seconds."""

    def counts(self) -> Counts | None:
        """What the kernel has counted of its connection."""


class Figures(NamedTuple):
    """What is measured of one link, see `LinkStatus`: seconds, a share from 0 to 1, and bytes.

    None is what is not measured yet, or what the kernel does not tell.
    """

    round_trip: float | None
    loss: float | None
    sent: int | None
    received: int | None


class Watch:
    """The links of the host number `here` of `hosts`; `now` is a monotonic clock, in seconds."""

    def __init__(self, hosts: Sequence[str], here: int, now: Callable[[], float]) -> None:
        self._now = now
        self._beats = {host: Heartbeats(first=here < number) for number, host in enumerate(hosts)}
        self._links: dict[str, tuple[Link, Traffic]] = {}
        #: The figures of each link as they were when its counters were read last, every few seconds.
        self.latest: dict[str, Figures] = {}

    def linked(self, host: str, link: Link) -> None:
        """A link with a host is made, in place of one before."""
        self._beats[host].begin(self._now())
        self._links[host] = link, Traffic()

    def unlinked(self, host: str) -> None:
        """There is none any more."""
        del self._links[host]
        self.latest.pop(host, None)

    def look(self, host: str, silent: float) -> Silence:
        """Look at a link that has been `silent` for so many seconds, and send a heartbeat if one is due."""
        beats, now = self._beats[host], self._now()
        link, traffic = self._links[host]
        if traffic.is_due(now):
            self.latest[host] = self.figures(host)
        if silent > beats.lost_after(now):
            return "lost"
        if beats.is_due(now, silent):
            with suppress(AddressError):
                link.send(Ping(beats.send(now)))
        return "suspected" if silent > beats.suspect_after(now) else ""

    def asked(self, host: str, link: Link, ping: Ping) -> None:
        """A heartbeat has come over a link with a host, or with an observer, who is ''."""
        if host:
            self._beats[host].received()
        link.send(Pong(ping.token))

    def answered(self, host: str, pong: Pong) -> None:
        """An answer has come over the link with a host."""
        beats = self._beats.get(host)
        if beats is None or host not in self._links:
            return
        beats.answered(pong.token, self._now())
        if beats.round_trip.mean is not None:
            self._links[host][0].expect(beats.round_trip.mean)

    def round_trip(self, host: str) -> float | None:
        """The smoothed round-trip time of the link with a host, in seconds; None while that is not known."""
        return self._beats[host].round_trip.mean if host in self._links else None

    def answers_within(self, host: str) -> float | None:
        """The time within which a linked host answers, in seconds; None while that is not known."""
        return self._beats[host].round_trip.bound if host in self._links else None

    def figures(self, host: str) -> Figures:
        """What is measured of the link with a linked host, up to this moment."""
        link, traffic = self._links[host]
        traffic.read(link.counts(), self._now())
        counts = traffic.counts
        sent, received = (counts.bytes_sent, counts.bytes_received) if counts is not None else (None, None)
        return Figures(self.round_trip(host), traffic.loss, sent, received)
