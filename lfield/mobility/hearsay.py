"""When each host of a team last gave a sign of life, to this host or to anybody who could tell it. Pure.

A host that has no link to another may be told by a third that it lives. Every host counts its own signs of
life and tells its count to all it is linked with, together with the counts that it has heard of the others. A
count that grows is a sign of life, however many hosts it came through and however long that took; one that is
only repeated is none. So no rumour feeds itself, and no clocks are compared.
"""

from __future__ import annotations

from collections.abc import Container, Sequence

from lfield.mobility.fates import Absent
from lfield.wire.messages import Heard, SignOfLife

#: Seconds between two tellings.
TELL_EVERY = 1.0
#: A shorter silence than this says nothing: a sign of life may be as long on its way round.
LEAST = 3.0
#: How many lives of a host are told apart; an older one's count is news again, once.
MOST_LIVES = 64


class Hearsay:
    """What one host has heard of the others; all times are in seconds of its monotonic clock.

    `hosts` are the deployment's, `here` this host's number, `incarnation` its life, `now` when that began.
    """

    def __init__(self, hosts: Sequence[str], here: int, incarnation: int, now: float) -> None:
        self._hosts, self._here, self._incarnation = hosts, here, incarnation
        self._others = [host for number, host in enumerate(hosts) if number != here]
        self._count = 0
        #: Of each host the counts of its lives, and its last sign of life.
        self._counts: dict[int, dict[int, int]] = {}
        self._newest: dict[int, SignOfLife] = {}
        #: When anything came last from a host in any way, and the hosts that are linked, with their lives.
        self._heard: dict[str, float] = {}
        self._linked: dict[str, int] = {}
        self._began = now
        #: The hosts that have ended for certain, and those that were restarted since they were first linked.
        self.gone: set[str] = set()
        self._lives: dict[str, int] = {}
        self.restarted: set[str] = set()
        #: When `tell` is due; None when there is nobody to tell of.
        self.due: float | None = now if len(hosts) > 2 else None

    @property
    def whole(self) -> bool:
        """Whether all hosts are linked, and always were in this life: then everybody tells of endings."""
        return len(self._linked) == len(self._others) and not self.restarted

    @property
    def links(self) -> list[str]:
        """The hosts that can be talked to."""
        return list(self._linked)

    def linked(self, host: str, incarnation: int) -> bool:
        """A host can be talked to; whether it was restarted since it was last linked."""
        self._linked[host] = incarnation
        restarted = self._lives.get(host, incarnation) != incarnation
        self._lives[host] = incarnation
        if restarted:
            self.restarted.add(host)
        return restarted

    def unlinked(self, host: str, now: float) -> None:
        """It cannot any more."""
        self._linked.pop(host, None)
        self._heard[host] = now

    def tell(self, now: float) -> Heard:
        """What the others are told now: one more sign of this host, and those of the others."""
        self.due = now + TELL_EVERY
        self._count += 1
        own = SignOfLife(self._here, self._incarnation, self._count)
        return Heard([own, *self._newest.values()])

    def told(self, message: Heard, now: float) -> None:
        """Another host tells."""
        for sign in message.signs:
            if sign.host != self._here and sign.host < len(self._hosts) and self._news(sign):
                self._newest[sign.host] = sign
                self._heard[self._hosts[sign.host]] = now

    def _news(self, sign: SignOfLife) -> bool:
        counts = self._counts.setdefault(sign.host, {})
        if sign.count <= counts.get(sign.incarnation, 0):
            return False
        counts[sign.incarnation] = sign.count
        if len(counts) > MOST_LIVES:
            del counts[next(iter(counts))]
        return True

    def absent(self, answered: Container[str], now: float, lost_after: float, unmet: float) -> Absent:
        """The hosts that did not answer, by what is known of them.

        One is unheard when nobody has heard it for `lost_after` seconds; one of which no sign ever came here,
        for `unmet` seconds.
        """
        unheard, elsewhere = {}, []
        for host in self._others:
            if host in answered or host in self.gone:
                continue
            last = now if host in self._linked else self._heard.get(host)
            silent = now - (self._began if last is None else last)
            if silent >= (unmet if last is None else max(lost_after, LEAST)):
                unheard[host] = silent
            else:
                elsewhere.append(host)
        return Absent(self.gone, unheard, elsewhere, self._linked)
