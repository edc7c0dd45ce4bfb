"""Who has which resource of one host for itself (`reserve`, decision 53). Pure: a clock is given as numbers.

A reservation has a number, a holder (one start of a coordinator) and a lease. Its page is on the disk before
the number is told, and numbers of a resource rise for ever, so a call with an old one is known for what it
is. Who would have to wait stands in one queue for each resource, those who reserve and those who only call:
first come, first served. All times are in seconds of the host's clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Literal

from lfield.capability.directory.news import Reserved

#: One start of a coordinator.
Start = tuple[str, int]
#: So long a call that may begin keeps its place before those who want to reserve, in seconds.
MAKES_WAY = 1.0

RESERVED, LOST = "ReservedException", "ReservationLostException"


@dataclass(frozen=True, slots=True)
class Held:
    """A reservation that somebody has: since when, and until when if nothing more is heard of its holder."""

    resource: str
    number: int
    holder: Start
    since: float
    until: float


@dataclass(frozen=True, slots=True)
class Write:
    """Have on the disk who has a resource (`holder` None: nobody), then call `Reservations.written`.

    With `soon` it may wait for company: nothing depends on it.
    """

    resource: str
    number: int
    holder: Start | None
    soon: bool


@dataclass(frozen=True, slots=True)
class Let:
    """Somebody who waits may ask again."""

    start: Start


@dataclass(frozen=True, slots=True)
class Refuse:
    """Somebody who wanted to reserve has waited long enough: a ReservedException with this message."""

    start: Start
    resource: str
    message: str


Effect = Write | Let | Refuse


class Refused(Exception):
    """What was asked for is not given: the exception of L that says so, and its message."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind, self.message = kind, message


@dataclass(frozen=True, slots=True)
class _Waiting:
    """Somebody in a queue. A call that `may` begin is there until it does, or until its deadline."""

    start: Start
    wants: Literal["take", "call"]
    deadline: float
    may: bool = False


@dataclass(slots=True)
class _Resource:
    """One resource: the last number that was given, who has it, and who waits for it."""

    number: int
    holder: Start | None = None
    since: float = 0.0
    until: float = 0.0
    #: Whether the page of the holder is on the disk, and whether it has its number.
    written: bool = False
    told: bool = False
    #: How the last one ended: its holder, the reason, and when.
    ended: tuple[Start, str, float] | None = None
    queue: deque[_Waiting] = field(default_factory=deque)
    #: Calls that have waited as long as they may, until they are made again.
    late: set[Start] = field(default_factory=set)

    def place(self, start: Start) -> _Waiting | None:
        """Where somebody stands in the queue."""
        return next((waiting for waiting in self.queue if waiting.start == start), None)

    def gives_way(self, start: Start) -> bool:
        """Whether an earlier start of a coordinator has what a later one wants, or the same one had it."""
        return self.holder is not None and self.holder[0] == start[0] and self.holder[1] <= start[1]

    def makes_way(self, start: Start) -> bool:
        """Whether somebody waits for the resource to be free who has come before this one."""
        ahead = takewhile(lambda waiting: waiting.start != start, self.queue)
        return any(waiting.wants == "take" for waiting in ahead)


class Reservations:
    """The reservations of one host's resources.

    `first` is a number that no earlier life of this host can have given, for a resource of which nothing is
    on record. `wait` says for how long others wait for a resource; `busy(resource, agent)` whether a portal
    call of anybody but that coordinator is under way in it.
    """

    def __init__(
        self,
        first: int,
        lease: float,
        wait: Callable[[str], float],
        busy: Callable[[str, str], bool],
    ) -> None:
        self._first, self._lease, self._wait, self._busy = first, lease, wait, busy
        self._resources: dict[str, _Resource] = {}
        self._effects: list[Effect] = []

    def restore(self, resource: str, number: int, holder: Start | None, now: float) -> None:
        """What the disk has from an earlier life: whoever has it by that goes on for one lease."""
        found = self._resources[resource] = _Resource(number, holder, now, now + self._lease)
        found.written = found.told = holder is not None

    # --- out ------------------------------------------------------------------------------------------

    def take_effects(self) -> list[Effect]:
        """What is to be done, in this order; each is given once."""
        effects, self._effects = self._effects, []
        return effects

    @property
    def due(self) -> float | None:
        """When `tick` has something to do next, None for never."""
        return min(self._dues(), default=None)

    def _dues(self) -> Iterator[float]:
        for found in self._resources.values():
            if found.holder is not None and found.written:
                yield found.until
            yield from (waiting.deadline for waiting in found.queue)

    @property
    def held(self) -> Mapping[str, Held]:
        """The reservations that somebody has, by resource."""
        return {name: held for name in self._resources if (held := self.of(name)) is not None}

    @property
    def known(self) -> Collection[str]:
        """The resources that were ever reserved, or asked about."""
        return self._resources

    def concerns(self, resource: str) -> bool:
        """Whether calls of a resource have to ask: somebody has it, or waits for it."""
        found = self._resources.get(resource)
        return found is not None and (found.holder is not None or bool(found.queue) or bool(found.late))

    def of(self, resource: str) -> Held | None:
        """Who has a resource; None for nobody."""
        found = self._resources.get(resource)
        if found is None or found.holder is None:
            return None
        return Held(resource, found.number, found.holder, found.since, found.until)

    def waits_for(self, start: Start) -> str:
        """The resource that somebody waits for, '' for none."""
        return next((name for name, found in self._resources.items() if found.place(start)), "")

    # --- coordinators ask -----------------------------------------------------------------------------

    def take(self, start: Start, resource: str, now: float, *, nested: bool) -> int:
        """The number of a reservation for somebody, 0 when it has to wait. Raises Refused.

        A later start of a coordinator takes over what an earlier one has. Who asks again for what it was told
        it has gets a new number: what was said of the old one may still be on its way.
        """
        found = self._find(resource, now)
        if found.holder == start and not found.told:
            found.told, found.until = found.written, now + self._lease
            return found.number if found.written else 0
        free = found.holder is None and not found.queue and not self._busy(resource, start[0])
        if free or found.gives_way(start):
            self._grant(resource, found, start, now)
        elif nested or self._wait(resource) <= 0:
            raise Refused(RESERVED, self._words(resource, found, now, start))
        else:
            self._queue_up(found, _Waiting(start, "take", now + self._wait(resource)))
        return 0

    def serves(self, start: Start, resource: str, number: int, now: float, *, nested: bool = False) -> bool:
        """Whether a portal may begin for somebody who has it by this number (0: not at all); else it waits.

        Raises Refused, at once for who has something else (`nested`) and would have to wait. A call of the
        holder without the number is made outside of its block: so it has left that, and what says so was
        lost, or is on its way.
        """
        found = self._find(resource, now)
        if number:
            if found.holder != start or found.number != number:
                raise Refused(LOST, self._lost(resource, found, start, number, now))
            found.until = now + self._lease
            return True
        if found.holder == start and found.told:
            self._end(resource, found, "it has left the block", now)
        if found.holder is None and not found.makes_way(start):
            self._leave_queue(found, start)
            return True
        if start in found.late or nested or self._wait(resource) <= 0:
            self._leave_queue(found, start)
            raise Refused(RESERVED, self._words(resource, found, now, start))
        self._queue_up(found, _Waiting(start, "call", now + self._wait(resource)))
        return False

    def give_up(self, start: Start, now: float) -> bool:
        """Somebody waits no longer for anything; false when it did not."""
        waited = False
        for resource, found in self._resources.items():
            waited = self._leave_queue(found, start) or waited
            if found.holder == start and not found.told:
                waited = True
                self._end(resource, found, "it has not waited for it", now)
        return waited

    # --- what holders do ------------------------------------------------------------------------------

    def renew(self, start: Start, resource: str, number: int, now: float) -> None:
        """The holder lives, and is in its block."""
        found = self._find(resource, now)
        if found.holder == start and found.number == number:
            found.until = max(found.until, now + self._lease)

    def release(self, resource: str, number: int, now: float) -> None:
        """The holder has left its block."""
        found = self._find(resource, now)
        if found.holder is not None and found.number == number and found.told:
            self._end(resource, found, "it has left the block", now)

    def over(self, start: Start, why: str, now: float) -> None:
        """A start acts no more: it has ended, or is barred."""
        for resource, found in self._resources.items():
            self._leave_queue(found, start)
            if found.holder == start:
                self._end(resource, found, why, now)

    @property
    def concerned(self) -> set[Start]:
        """All that have something, or wait for it."""
        holders = {found.holder for found in self._resources.values() if found.holder is not None}
        return holders | {waiting.start for found in self._resources.values() for waiting in found.queue}

    @property
    def unwritten(self) -> list[tuple[str, Start]]:
        """The resources that are given to somebody as soon as that is on the disk."""
        return [(n, f.holder) for n, f in self._resources.items() if f.holder and not f.written]

    # --- disk and time --------------------------------------------------------------------------------

    def written(self, resource: str, number: int, now: float) -> None:
        """The page of a holder is on the disk: it may have its number."""
        found = self._resources[resource]
        if found.holder is not None and found.number == number and not found.written:
            found.written, found.until = True, now + self._lease
            self._effects.append(Let(found.holder))

    def tick(self, now: float) -> None:
        """Time has passed, or a portal call has ended: go on with whom that lets."""
        for resource, found in self._resources.items():
            self._expire(resource, found, now)
            for waiting in [waiting for waiting in found.queue if waiting.deadline <= now]:
                message = self._words(resource, found, now, waiting.start)
                self._leave_queue(found, waiting.start)
                if waiting.wants == "take":
                    self._effects.append(Refuse(waiting.start, resource, message))
                elif not waiting.may:
                    found.late.add(waiting.start)
                    self._effects.append(Let(waiting.start))
            self._serve_queue(resource, found, now)

    def postpone(self, now: float) -> None:
        """Time stood still for who waits and for who has something: they have all their time again."""
        for resource, found in self._resources.items():
            deadline = now + self._wait(resource)
            found.until = max(found.until, now + self._lease)
            found.queue = deque(replace(each, deadline=deadline) for each in found.queue)

    # --- inside ---------------------------------------------------------------------------------------

    def _find(self, resource: str, now: float) -> _Resource:
        if resource not in self._resources:
            self._resources[resource] = _Resource(self._first)
        found = self._resources[resource]
        self._expire(resource, found, now)
        return found

    def _expire(self, resource: str, found: _Resource, now: float) -> None:
        if found.holder is not None and found.written and found.until <= now:
            self._end(resource, found, "its lease was over", now)

    def _grant(self, resource: str, found: _Resource, start: Start, now: float) -> None:
        if found.holder is not None:
            found.ended = found.holder, "a later one was begun", now
            if not found.told:
                message = f"{resource} is reserved by a later start of {start[0]}"
                self._effects.append(Refuse(found.holder, resource, message))
        self._leave_queue(found, start)
        found.number, found.holder = found.number + 1, start
        found.since, found.until, found.written, found.told = now, now + self._lease, False, False
        self._effects.append(Write(resource, found.number, start, soon=False))

    def _end(self, resource: str, found: _Resource, why: str, now: float) -> None:
        assert found.holder is not None
        found.ended, found.holder = (found.holder, why, now), None
        self._effects.append(Write(resource, found.number, None, soon=True))
        self._serve_queue(resource, found, now)

    def _serve_queue(self, resource: str, found: _Resource, now: float) -> None:
        """Whoever is first may go on: calls at once, one that reserves when no other is at work there."""
        for place, waiting in enumerate(found.queue):
            if found.holder is not None:
                return
            if waiting.wants == "take":
                if place == 0 and not self._busy(resource, waiting.start[0]):
                    self._grant(resource, found, waiting.start, now)
                return
            if not waiting.may:
                found.queue[place] = replace(waiting, deadline=now + MAKES_WAY, may=True)
                self._effects.append(Let(waiting.start))

    def _queue_up(self, found: _Resource, waiting: _Waiting) -> None:
        before = found.place(waiting.start)
        if before is not None and (before.wants != waiting.wants or before.may):
            found.queue.remove(before)
            before = None
        if before is None:
            found.queue.append(waiting)

    def _leave_queue(self, found: _Resource, start: Start) -> bool:
        found.late.discard(start)
        place = found.place(start)
        if place is not None:
            found.queue.remove(place)
        return place is not None

    # --- words ----------------------------------------------------------------------------------------

    def _words(self, resource: str, found: _Resource, now: float, start: Start) -> str:
        """What keeps somebody from a resource."""
        if found.holder is not None:
            return f"{resource} is {Reserved(found.holder[0], found.since).sentence(now)}"
        ahead = next((each for each in found.queue if each.wants == "take" and each.start != start), None)
        if ahead is not None:
            return f"{resource} is about to be reserved by {ahead.start[0]}"
        return f"{resource} is at work for others, and cannot be reserved before that is done"

    def _lost(self, resource: str, found: _Resource, start: Start, number: int, now: float) -> str:
        """Why a number holds no more."""
        if found.holder is not None and found.holder != start:
            return f"{resource} was reserved by {found.holder[0]} since, {now - found.since:.1f} s ago"
        if found.ended is not None and found.ended[0] == start:
            _, why, when = found.ended
            return f"the reservation of {resource} has ended {now - when:.1f} s ago: {why}"
        if found.holder is None and found.ended is not None and found.number > number:
            (other, _), _, when = found.ended
            return f"{resource} was reserved by {other} since, and that has ended {now - when:.1f} s ago"
        return f"{resource} is reserved for {start[0]} no more: nothing is on record of it there"
