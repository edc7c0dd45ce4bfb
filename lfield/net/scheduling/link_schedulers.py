"""Link schedulers: bound the event-loop time for received messages, so that no peer delays guards.

Messages of guests (all peers that are no hosts of the team) are processed in small rounds with pauses.
Messages of members (hosts of the team) are processed at once within their CPU budgets (see `cpu_budgets`),
for at most SLICE per turn of the event loop, so that guard timers and operator messages run in between.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from typing import Protocol

from lfield.errors import CpuBudgetExceeded
from lfield.net.scheduling.cpu_budgets import CPU_SHARE, MAX_EXCESS_TIME, BudgetState, CpuBudgets
from lfield.net.scheduling.fair_queue import FairQueue, QueueRank
from lfield.net.scheduling.handshake_scheduler import HandshakeScheduler

#: Maximum messages of guests per round, maximum CPU seconds per round, and seconds from one round to the
#: next. Endless requests therefore delay neither guards and peers nor an emergency stop.
AT_ONCE, LONGEST, ROUND = 16, 0.002, 0.02
#: CPU seconds for messages of members per turn of the event loop, and the pause after which the next turn has
#: started.
SLICE, PAUSE = 0.005, 0.001
#: CPU seconds of a member that are charged together while its messages are processed at once: one charge for
#: some ten messages instead of one for each. The value is small in comparison with the BURST of a budget.
CHARGE_UNIT = 0.002
#: A number of turns that does not fit into a slice.
_MANY = 1 << 30


class PendingInput(Protocol):
    """A link with unprocessed input."""

    def process_next(self) -> bool:
        """Process one message or a part of it. Returns whether more input is pending."""


class HandshakingLink(Protocol):
    """A link whose peer is not authenticated yet."""

    def advance_handshake(self) -> bool:
        """Process one received handshake step. Returns whether another is pending."""


class MemberLink(PendingInput, Protocol):
    """A link with a member."""

    @property
    def weight(self) -> int:
        """The amount of data that has arrived since answers are withheld: see `FramedLink.weight`."""

    def receive_frame(self, data: bytes) -> bool:
        """Process these bytes if they are exactly one frame; otherwise without effect."""

    def withhold(self, *, on: bool) -> None:
        """Withhold coordinators and answers from now on, or send the withheld ones."""

    def pause_reading(self, *, on: bool) -> None:
        """Pause reading, or resume it once no input is pending."""

    def on_excess(self, error: CpuBudgetExceeded) -> None:
        """The member exceeds its budget. Close the link if `error.closes`."""


class LinkScheduler:
    """Processes input of guests while the round has room; the rest in the next round.

    All calls happen on the thread of a running loop. `busy` is its CPU time; the sender does not cause its
    part `exempt`.
    """

    def __init__(
        self, busy: Callable[[], float] = time.thread_time, exempt: Callable[[], float] = float
    ) -> None:
        self._queue: FairQueue[PendingInput] = FairQueue(AT_ONCE, LONGEST)
        self.busy = busy
        self._timer: asyncio.TimerHandle | None = None
        self.members = MemberScheduler(busy, exempt)
        self.handshakes = HandshakeRunner(busy)

    def add(self, link: PendingInput, identity: str) -> None:
        """Add a guest of this identity that did not wait and now has pending input."""
        self._queue.add(link, identity)
        if self._timer is None:
            self._timer = asyncio.get_running_loop().call_later(ROUND, self._next_round)
        self._process()

    def remove(self, link: PendingInput) -> None:
        """Remove a closed guest; ignored if it does not wait."""
        self._queue.remove(link)

    def _process(self) -> None:
        start = self.busy()
        while (client := self._queue.next()) is not None:
            if not client.process_next():
                self._queue.remove(client)
            now = self.busy()
            self._queue.charge(now - start)
            start = now

    def _next_round(self) -> None:
        self._timer = None
        self._queue.start_round()
        self._process()
        if self._queue.is_used:
            self._timer = asyncio.get_running_loop().call_later(ROUND, self._next_round)


class HandshakeRunner:
    """Runs handshake steps of unauthenticated callers within their budget."""

    def __init__(self, busy: Callable[[], float]) -> None:
        self._busy, self._scheduler = busy, HandshakeScheduler[HandshakingLink]()
        self._timer: asyncio.TimerHandle | None = None

    def add(self, link: HandshakingLink, source: str, *, is_answered: bool) -> None:
        """Add a handshake step of a link that did not wait."""
        self._scheduler.add(link, source, is_answered=is_answered)
        if self._timer is None:
            self._process()

    def remove(self, link: HandshakingLink) -> None:
        """Remove a closed link; ignored if it does not wait."""
        self._scheduler.remove(link)

    def on_proven(self, source: str) -> None:
        """The peer at an address has authenticated."""
        self._scheduler.sources.on_proven(source)

    def on_failed(self, source: str) -> None:
        """A connection from the address ended before authentication."""
        self._scheduler.sources.on_failed(source)

    def _process(self) -> None:
        loop, self._timer = asyncio.get_running_loop(), None
        while (link := self._scheduler.next(loop.time())) is not None:
            start = self._busy()
            if not link.advance_handshake():
                self._scheduler.remove(link)
            self._scheduler.charge(self._busy() - start, loop.time())
        due = self._scheduler.due(loop.time())
        if due < math.inf:
            # Timers of some loops fire up to a millisecond early.
            self._timer = loop.call_at(due + PAUSE, self._process)


class MemberScheduler:
    """Processes messages of members within their budgets, in slices of the event loop. The clocks are those
    of `LinkScheduler`.
    """

    def __init__(self, busy: Callable[[], float], exempt: Callable[[], float]) -> None:
        self._busy, self._exempt = busy, exempt
        self._queue: FairQueue[MemberLink] = FairQueue(_MANY, SLICE)
        self._budgets = CpuBudgets()
        #: The open links of each member.
        self._links: dict[str, set[MemberLink]] = {}
        self._waiting: dict[MemberLink, str] = {}
        #: The time when a message was last processed, and the next planned slice.
        self._processed_at = -math.inf
        #: Seconds used by messages that were processed at once in this turn of the event loop.
        self._spent_at_once = 0.0
        #: Seconds of each member that are not yet charged to its budget.
        self._uncharged: dict[str, float] = {}
        self._next_slice: asyncio.Handle | None = None
        #: The probed members, with the timers for the ends of their probes.
        self._probes: dict[str, asyncio.TimerHandle] = {}
        #: The paused members, and the timer for the first to resume.
        self._paused: set[str] = set()
        self._release_timer: asyncio.TimerHandle | None = None

    def join(self, link: MemberLink, member: str) -> None:
        """A link was authenticated as a link of a member."""
        self._links.setdefault(member, set()).add(link)
        if member in self._probes:
            link.withhold(on=True)
        if member in self._paused:
            link.pause_reading(on=True)

    def on_handshake(self, link: MemberLink, member: str, seconds: float) -> None:
        """Charge a member with the CPU time of its handshake."""
        now = asyncio.get_running_loop().time()
        self._apply_budget(link, member, self._budgets.on_handshake(member, seconds, now), now)

    def process_at_once(self, link: MemberLink, member: str, data: bytes) -> bool:
        """Process a message now, if these bytes are exactly one message and no other link precedes.

        Returns False without effect when the bytes have to be queued.
        """
        loop, queue = asyncio.get_running_loop(), self._queue
        if self._waiting or self._probes or self._paused or self._next_slice is not None or queue.ranks:
            return False
        if loop.time() - self._processed_at >= PAUSE:
            self._spent_at_once = 0.0
            if queue.charged:
                queue.start_round()
        start, exempt = self._busy(), self._exempt()
        if not link.receive_frame(data):
            return False
        spent = self._busy() - start
        self._processed_at = now = loop.time()
        self._spent_at_once += spent
        if member in self._links:
            uncharged = self._uncharged.get(member, 0.0) + spent - (self._exempt() - exempt)
            if uncharged >= CHARGE_UNIT:
                budget = self._budgets.on_work(member, uncharged, now)
                uncharged = 0.0
                if budget is not BudgetState.WITHIN:
                    self._apply_budget(link, member, budget, now)
            self._uncharged[member] = uncharged
        if self._spent_at_once + queue.charged >= SLICE and self._next_slice is None:
            self._charge_at_once()
            self._next_slice = loop.call_soon(self._next_slice_due)
        return True

    def _charge_at_once(self) -> None:
        """Charge messages that were processed at once in this turn."""
        self._queue.charge(self._spent_at_once)
        self._spent_at_once = 0.0

    def add(self, link: MemberLink, member: str) -> None:
        """Add a link that did not wait and now has pending input."""
        if self._next_slice is None and asyncio.get_running_loop().time() - self._processed_at >= PAUSE:
            self._queue.start_round()
            self._spent_at_once = 0.0
        self._charge_at_once()
        self._waiting[link] = member
        self._queue.add(link, member)
        self._process()

    def remove(self, link: MemberLink, member: str) -> None:
        """Remove a closed link; ignored if it does not wait."""
        self._queue.remove(link)
        self._waiting.pop(link, None)
        links = self._links.get(member, set())
        links.discard(link)
        if not links:
            self._links.pop(member, None)

    def _process(self) -> None:
        loop, start = asyncio.get_running_loop(), self._busy()
        while (link := self._queue.next()) is not None:
            exempt = self._exempt()
            more = link.process_next()
            ended = self._busy()
            spent, start = ended - start, ended
            self._queue.charge(spent)
            self._processed_at = now = loop.time()
            self._on_processed(link, spent - (self._exempt() - exempt), now, more=more)
        if self._queue.is_full and self._next_slice is None:
            self._next_slice = loop.call_soon(self._next_slice_due)

    def _next_slice_due(self) -> None:
        self._next_slice = None
        self._queue.start_round()
        self._process()

    def _on_processed(self, link: MemberLink, seconds: float, now: float, *, more: bool) -> None:
        member = self._waiting.get(link)
        if member is None:
            # The link was closed in the meantime.
            return
        weight = link.weight if member in self._probes else 0
        seconds += self._uncharged.pop(member, 0.0)
        budget = self._budgets.on_work(member, seconds, now, weight)
        if not more:
            self._queue.remove(link)
            del self._waiting[link]
        self._apply_budget(link, member, budget, now)

    def _apply_budget(self, link: MemberLink, member: str, budget: BudgetState, now: float) -> None:
        if budget is BudgetState.WITHIN:
            self._queue.set_rank(member, QueueRank.FIRST)
            return
        if member not in self._probes and self._budgets.probe_ends(member) is not None:
            for each in self._links.get(member, ()):
                each.withhold(on=True)
            self._plan_probe_end(member)
        if budget is BudgetState.FLOOD:
            self._budgets.on_closed(member, now)
            link.on_excess(CpuBudgetExceeded(CPU_SHARE, MAX_EXCESS_TIME, closes=True))
            return
        if self._budgets.may_report(member, now):
            link.on_excess(CpuBudgetExceeded(CPU_SHARE, MAX_EXCESS_TIME, closes=False))
        if budget is BudgetState.HELD:
            self._pause(member)
        elif member not in self._paused:
            self._queue.set_rank(member, QueueRank.BEHIND)

    def _plan_probe_end(self, member: str) -> None:
        """Plan the release of withheld answers, when the member has passed its probe or was closed."""
        loop, ends = asyncio.get_running_loop(), self._budgets.probe_ends(member)
        # Timers of some loops fire up to a millisecond early.
        if ends is not None and ends > loop.time() + PAUSE:
            self._probes[member] = loop.call_at(ends, self._plan_probe_end, member)
            return
        if ends is not None:
            self._budgets.on_probe_end(member, loop.time())
        self._probes.pop(member, None)
        for link in list(self._links.get(member, ())):
            link.withhold(on=False)

    def _pause(self, member: str) -> None:
        self._paused.add(member)
        self._queue.set_rank(member, QueueRank.HELD)
        for link in self._links.get(member, ()):
            link.pause_reading(on=True)
        self._plan_release()

    def _plan_release(self) -> None:
        if self._release_timer is not None:
            self._release_timer.cancel()
        due = min((self._budgets.held_until(member) for member in self._paused), default=None)
        loop = asyncio.get_running_loop()
        self._release_timer = None if due is None else loop.call_at(due, self._on_release)

    def _on_release(self) -> None:
        now = asyncio.get_running_loop().time()
        # Timers of some loops fire up to a millisecond early.
        free = {member for member in self._paused if self._budgets.held_until(member) <= now + PAUSE}
        self._paused -= free
        for member in sorted(free):
            self._queue.set_rank(member, QueueRank.BEHIND)
            for link in list(self._links.get(member, ())):
                link.pause_reading(on=False)
        self._plan_release()
        if self._next_slice is None:
            self._next_slice_due()
