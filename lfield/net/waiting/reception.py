"""Where everybody waits until their messages are taken, so that no peer keeps a host from its guards.

Of all that are no hosts of the team a few messages at a time are taken, then there is a pause. Messages of
members (hosts of the team) are taken at once while each is within its budget of processing time; see
`rations`. No turn of the event loop takes messages of members for longer than SLICE: timers of guards and the
messages of persons come in between.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from typing import Protocol

from lfield.errors import OverBudget
from lfield.net.waiting.handshakes import Handshakes
from lfield.net.waiting.rations import OVER_FOR, RATION, Rations, Standing
from lfield.net.waiting.turns import Rank, Turns

#: So many messages of all that are no hosts are taken in a round, none more when those have taken so many
#: seconds of a processor, and seconds from one round to the next. Whoever asks without an end so keeps a host
#: neither from its guards and peers nor from an emergency stop.
AT_ONCE, LONGEST, ROUND = 16, 0.002, 0.02
#: Seconds of a processor for messages of members in one turn of the event loop. After so many seconds without
#: any, the next turn has begun.
SLICE, PAUSE = 0.005, 0.001
#: More turns than fit into a slice.
_MANY = 1 << 30


class Waiting(Protocol):
    """Somebody of whom more has come than was taken."""

    def take_one(self) -> bool:
        """Take one message, or a part of one; whether there is more."""


class Shaking(Protocol):
    """A link whose other end has not proven who it is."""

    def shake_hands(self) -> bool:
        """Take a part of its handshake that has come; whether another part of it has."""


class MemberLink(Waiting, Protocol):
    """A link to a member."""

    @property
    def weight(self) -> int:
        """How much has come since answers are withheld: see `FramedLink.weight`."""

    def withhold(self, *, on: bool) -> None:
        """Send neither coordinators nor answers from now on, or all of them that wait."""

    def hold(self, *, on: bool) -> None:
        """Stop reading, or read again once nothing waits."""

    def on_excess(self, error: OverBudget) -> None:
        """The member is over its budget. Where `error.closes`, end the link."""


class Reception:
    """What has come of guests is taken as far as there is room in this round, at once; the rest in the next.

    All calls happen on the thread of a running loop, and `busy` says how long that has been at work. `exempt`
    of it is not the work of whoever has sent a message.
    """

    def __init__(
        self, busy: Callable[[], float] = time.thread_time, exempt: Callable[[], float] = float
    ) -> None:
        self._turns: Turns[Waiting] = Turns(AT_ONCE, LONGEST)
        self.busy = busy
        self._timer: asyncio.TimerHandle | None = None
        self.members = Members(busy, exempt)
        self.strangers = Strangers(busy)

    def enter(self, guest: Waiting, person: str) -> None:
        """There is something to take of a guest of this person that did not wait."""
        self._turns.enter(guest, person)
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(ROUND, self._again)
        self._take()

    def leave(self, guest: Waiting) -> None:
        """A guest has gone; it may not have waited."""
        self._turns.leave(guest)

    def _take(self) -> None:
        began = self.busy()
        while (guest := self._turns.next()) is not None:
            if not guest.take_one():
                self._turns.leave(guest)
            now = self.busy()
            self._turns.took(now - began)
            began = now

    def _again(self) -> None:
        self._timer = None
        self._turns.again()
        self._take()
        if self._turns.used:
            self._timer = asyncio.get_running_loop().call_later(ROUND, self._again)


class Strangers:
    """Continues handshakes of callers that have not proven who they are, as their budget allows."""

    def __init__(self, busy: Callable[[], float]) -> None:
        self._busy, self._handshakes = busy, Handshakes[Shaking]()
        self._timer: asyncio.TimerHandle | None = None

    def enter(self, link: Shaking, source: str, *, is_answered: bool) -> None:
        """A part of a handshake has come of a link that did not wait."""
        self._handshakes.enter(link, source, is_answered=is_answered)
        if self._timer is None:
            self._take()

    def leave(self, link: Shaking) -> None:
        """A link has gone; it may not have waited."""
        self._handshakes.leave(link)

    def on_proven(self, source: str) -> None:
        """Who is at an address has proven who it is."""
        self._handshakes.sources.on_proven(source)

    def on_failed(self, source: str) -> None:
        """A connection from there ended before anybody had proven who it is."""
        self._handshakes.sources.on_failed(source)

    def _take(self) -> None:
        loop, self._timer = asyncio.get_running_loop(), None
        while (link := self._handshakes.next(loop.time())) is not None:
            began = self._busy()
            if not link.shake_hands():
                self._handshakes.leave(link)
            self._handshakes.took(self._busy() - began, loop.time())
        due = self._handshakes.due(loop.time())
        if due < math.inf:
            # Timers of some loops are early by up to a millisecond.
            self._timer = loop.call_at(due + PAUSE, self._take)


class Members:
    """Takes messages of members as their rations allow, in slices of the event loop. The clocks as above."""

    def __init__(self, busy: Callable[[], float], exempt: Callable[[], float]) -> None:
        self._busy, self._exempt = busy, exempt
        self._turns: Turns[MemberLink] = Turns(_MANY, SLICE)
        self._rations = Rations()
        #: The open links of each member.
        self._links: dict[str, set[MemberLink]] = {}
        self._waiting: dict[MemberLink, str] = {}
        #: When a message was last taken, and the next slice where one is planned.
        self._taken_at = -math.inf
        self._next_slice: asyncio.Handle | None = None
        #: The members that are probed, with the timers for the ends of their probes.
        self._probes: dict[str, asyncio.TimerHandle] = {}
        #: The members that are not read now, and the timer for the first that will be.
        self._held: set[str] = set()
        self._release: asyncio.TimerHandle | None = None

    def join(self, link: MemberLink, member: str) -> None:
        """A link has proven that it is of a member."""
        self._links.setdefault(member, set()).add(link)
        if member in self._probes:
            link.withhold(on=True)
        if member in self._held:
            link.hold(on=True)

    def on_handshake(self, link: MemberLink, member: str, seconds: float) -> None:
        """To prove that has taken so many seconds of a processor: the member's, as for its messages."""
        now = asyncio.get_running_loop().time()
        self._judge(link, member, self._rations.on_handshake(member, seconds, now), now)

    def enter(self, link: MemberLink, member: str) -> None:
        """There is something to take of a link that did not wait."""
        if self._next_slice is None and asyncio.get_running_loop().time() - self._taken_at >= PAUSE:
            self._turns.again()
        self._waiting[link] = member
        self._turns.enter(link, member)
        self._take()

    def leave(self, link: MemberLink, member: str) -> None:
        """A link has gone; it may not have waited."""
        self._turns.leave(link)
        self._waiting.pop(link, None)
        links = self._links.get(member, set())
        links.discard(link)
        if not links:
            self._links.pop(member, None)

    def _take(self) -> None:
        loop, began = asyncio.get_running_loop(), self._busy()
        while (link := self._turns.next()) is not None:
            exempt = self._exempt()
            more = link.take_one()
            ended = self._busy()
            spent, began = ended - began, ended
            self._turns.took(spent)
            self._taken_at = now = loop.time()
            self._on_taken(link, spent - (self._exempt() - exempt), now, more=more)
        if self._turns.is_full and self._next_slice is None:
            self._next_slice = loop.call_soon(self._slice)

    def _slice(self) -> None:
        self._next_slice = None
        self._turns.again()
        self._take()

    def _on_taken(self, link: MemberLink, seconds: float, now: float, *, more: bool) -> None:
        member = self._waiting.get(link)
        if member is None:
            # It has gone meanwhile.
            return
        weight = link.weight if member in self._probes else 0
        standing = self._rations.on_work(member, seconds, now, weight)
        if not more:
            self._turns.leave(link)
            del self._waiting[link]
        self._judge(link, member, standing, now)

    def _judge(self, link: MemberLink, member: str, standing: Standing, now: float) -> None:
        if standing is Standing.WITHIN:
            self._turns.rank(member, Rank.FIRST)
            return
        if member not in self._probes and self._rations.probe_ends(member) is not None:
            for each in self._links.get(member, ()):
                each.withhold(on=True)
            self._plan_probe_end(member)
        if standing is Standing.FLOOD:
            self._rations.on_closed(member, now)
            link.on_excess(OverBudget(RATION, OVER_FOR, closes=True))
            return
        if self._rations.may_report(member, now):
            link.on_excess(OverBudget(RATION, OVER_FOR, closes=False))
        if standing is Standing.HELD:
            self._hold(member)
        elif member not in self._held:
            self._turns.rank(member, Rank.BEHIND)

    def _plan_probe_end(self, member: str) -> None:
        """Have the answers for a member sent when it has shown that it waits for them, or was closed."""
        loop, ends = asyncio.get_running_loop(), self._rations.probe_ends(member)
        # Timers of some loops are early by up to a millisecond.
        if ends is not None and ends > loop.time() + PAUSE:
            self._probes[member] = loop.call_at(ends, self._plan_probe_end, member)
            return
        if ends is not None:
            self._rations.on_probe_end(member, loop.time())
        self._probes.pop(member, None)
        for link in list(self._links.get(member, ())):
            link.withhold(on=False)

    def _hold(self, member: str) -> None:
        self._held.add(member)
        self._turns.rank(member, Rank.HELD)
        for link in self._links.get(member, ()):
            link.hold(on=True)
        self._plan_release()

    def _plan_release(self) -> None:
        if self._release is not None:
            self._release.cancel()
        due = min((self._rations.held_until(member) for member in self._held), default=None)
        loop = asyncio.get_running_loop()
        self._release = None if due is None else loop.call_at(due, self._on_release)

    def _on_release(self) -> None:
        now = asyncio.get_running_loop().time()
        # Timers of some loops are early by up to a millisecond.
        free = {member for member in self._held if self._rations.held_until(member) <= now + PAUSE}
        self._held -= free
        for member in sorted(free):
            self._turns.rank(member, Rank.BEHIND)
            for link in list(self._links.get(member, ())):
                link.hold(on=False)
        self._plan_release()
        if self._next_slice is None:
            self._slice()
