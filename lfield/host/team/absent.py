"""For how long a coordinator waits for a host that cannot be talked to: not at all for one that is lost.

A coordinator under a time limit is sent over a link only when the other host has just been heard: what was
sent into silence would be in doubt for as long as that lasts, whatever the limit. The host is asked for a
sign of life first, and until that has come the coordinator can still go on where it is.

A host that was linked and is away has until `unreachable_after` counts out, from the end of its link and not
from the call. Who calls when half of that is over does not begin to wait: the host is known to be lost, until
it is linked again. One that nobody has ever met may just be starting, so it gets all the time. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from lfield.clock import Clock
from lfield.host.effects import Effect, Nearby
from lfield.mobility.core import Mobility
from lfield.mobility.effects import Send
from lfield.mobility.hearsay import Hearsay
from lfield.vm.agent import Member
from lfield.wire.messages import QUESTION, Ping

#: The part of `unreachable_after` after which a host that is away is lost to who would call it.
LOST_AFTER = 0.5
#: Seconds without anything from a linked host, beyond the time of an answer, after which nobody is sent there
#: who need not go.
SILENT_FOR = 2.0
#: A host that was heard this many seconds ago need not be asked for a sign of life: with less, a hop under a
#: time limit takes a round trip more.
JUST_NOW = 0.1
#: Seconds that whoever is over a time limit waits for a sign of life, at the least; and at the most, where
#: answers take long.
GRACE, MOST_GRACE = 0.3, 2.0


class Absent:
    """What one host knows of others that it cannot talk to; `unreachable_after` is in seconds."""

    def __init__(
        self,
        nearby: Nearby,
        hearsay: Hearsay,
        clock: Clock,
        unreachable_after: float,
        mobility: Mobility,
        effects: Callable[[Effect], None],
    ) -> None:
        self._nearby, self._hearsay, self._clock = nearby, hearsay, clock
        self._unreachable_after, self._mobility, self._out = unreachable_after, mobility, effects
        #: When each host was asked for a sign of life the last time.
        self._asked: dict[str, float] = {}

    def is_linked(self, host: str) -> bool:
        """Whether a host can be talked to: then it is neither away nor lost."""
        return self._hearsay.is_linked(host)

    def is_silent(self, host: str) -> bool:
        """Whether nothing has come for a while over a link that is asked for signs of life every second."""
        heard = self._nearby.last_heard(host)
        if heard is None or not self._hearsay.is_linked(host):
            return False
        now = self._clock.monotonic()
        answer = self._nearby.answers_within(host) or 0.0
        silent = host in self._hearsay.near and now - heard > SILENT_FOR + answer
        grace = min(MOST_GRACE, max(GRACE, answer))
        return silent or (self._is_unanswered(host, heard) and now >= self._asked[host] + grace)

    def ask(self, host: str, within: float = JUST_NOW) -> None:
        """Ask a linked host for a sign of life, unless it is being asked or was heard just now.

        That is `within` so many seconds, and within 0.1 s.
        """
        heard, now = self._nearby.last_heard(host), self._clock.monotonic()
        if heard is None or not self._hearsay.is_linked(host) or now - heard <= min(within, JUST_NOW):
            return
        if not self._is_unanswered(host, heard) and self._mobility.ask(host):
            self._asked[host] = now
            self._out(Send(host, Ping(QUESTION)))

    def transit(self, host: str) -> float:
        """For how many seconds a message is on its way from or to a linked host; 0 where that is unknown."""
        return (self._nearby.round_trip(host) or 0.0) / 2.0

    def arrives_in(self, host: str) -> float:
        """In how many seconds a coordinator that leaves now for a linked host is there; 0 for another host.

        A question for a sign of life, and its answer, come first where they are due.
        """
        heard = self._nearby.last_heard(host)
        if heard is None or not self._hearsay.is_linked(host):
            return 0.0
        asks = self._clock.monotonic() - heard > JUST_NOW
        return self.transit(host) * (3.0 if asks else 1.0)

    def is_asked(self, host: str) -> bool:
        """Whether a sign of life of a linked host is still waited for."""
        heard = self._nearby.last_heard(host)
        if heard is None or not self._hearsay.is_linked(host):
            return False
        return self._is_unanswered(host, heard) and not self.is_silent(host)

    def _is_unanswered(self, host: str, heard: float) -> bool:
        return heard <= self._asked.get(host, -math.inf)

    def away(self, host: str) -> float:
        """For how many seconds a host that was linked has not been; 0 for one that was never met, or is."""
        return 0.0 if self._nearby.last_heard(host) is None else self._missing(host)

    def lost(self, host: str) -> str:
        """Why nobody need wait for a host, '' when it may be reached in time."""
        if self._hearsay.is_linked(host):
            return ""
        if host in self._hearsay.gone:
            return f"{host} could not be reached: it has ended"
        is_met, missing = self._nearby.last_heard(host) is not None, self._missing(host)
        if missing and missing >= (LOST_AFTER if is_met else 1.0) * self._unreachable_after:
            seconds = f"{missing:.{0 if missing >= 10 else 1}f} s"
            return f"{host} could not be reached: there has been no link for {seconds}; is it up?"
        return ""

    def _missing(self, host: str) -> float:
        """For how many seconds a host that is wanted has had no link; 0 for one that has, or is unwanted."""
        since = self._nearby.away.get(host)
        if since is None or self._hearsay.is_linked(host):
            return 0.0
        return max(0.0, self._clock.monotonic() - since)


class SignsOfLife:
    """What a machine asks of the hosts where agents of the team are: `lfield.vm.attached.Signs`."""

    def __init__(self, absent: Absent, hosts: Sequence[str]) -> None:
        self._absent, self._hosts = absent, hosts

    def is_silent(self, member: Member) -> bool:
        """Whether its host has not been heard, though there is a link."""
        return self._absent.is_silent(self._hosts[member.host])

    def ask(self, member: Member, within: float) -> None:
        """Ask its host for a sign of life, unless it was heard in the last `within` seconds."""
        self._absent.ask(self._hosts[member.host], within)

    def is_asked(self, member: Member) -> bool:
        """Whether that is still waited for."""
        return self._absent.is_asked(self._hosts[member.host])

    def transit(self, member: Member) -> float:
        """In how many seconds a coordinator that leaves now is at its host."""
        return self._absent.arrives_in(self._hosts[member.host])
