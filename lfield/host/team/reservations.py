"""Exclusive reservations of one host's resources (`reserve`, decision 53). Sans-IO: the time is passed in.

A reservation has a number, a holder (one start of a coordinator) and a lease. Its record is on disk before
the number is given out, and the numbers of a resource only rise, so a call with an outdated number is
detected. Waiting coordinators form one FIFO queue for each resource, whether they reserve or only call. All
times are in seconds of the host's clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import takewhile
from typing import Literal

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.capability.directory.directory_delta import ReservedBy

#: One start of a coordinator.
StartKey = tuple[str, int]
#: Seconds for which a call that may start keeps its place before coordinators that want to reserve.
PREEMPT_AFTER = 1.0

RESERVED, LOST = "ReservedException", "ReservationLostException"


class HeldReservation(Struct, frozen=True):
    """A reservation: the start of the hold, and its expiry unless it is renewed."""

    resource: str
    number: int
    holder: StartKey
    held_since: float
    expires_at: float


class PersistHolder(Struct, frozen=True):
    """Record the holder of a resource (`holder` None: free), then call `Reservations.on_durable`.

    With `is_lazy` it may be written together with other records: no effect depends on it.
    """

    resource: str
    number: int
    holder: StartKey | None
    is_lazy: bool


class RetryWaiter(Struct, frozen=True):
    """A waiting coordinator may repeat its request."""

    start: StartKey


class DenyWaiter(Struct, frozen=True):
    """A coordinator has waited too long to reserve: a ReservedException with this message."""

    start: StartKey
    resource: str
    message: str


Effect = PersistHolder | RetryWaiter | DenyWaiter


class ReservationDenied(Exception):
    """A denied request: the exception of L, and its message."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind, self.message = kind, message


class _Waiting(Struct, frozen=True):
    """An entry in a queue. A call that `may_proceed` stays in the queue until it starts, or until its
    deadline.
    """

    start: StartKey
    purpose: Literal["take", "call"]
    deadline: float
    may_proceed: bool = False


class _Resource(Struct):
    """One resource: the last number given out, its holder, and its queue."""

    number: int
    holder: StartKey | None = None
    since: float = 0.0
    until: float = 0.0
    #: Whether the record of the holder is on disk, and whether the holder has received its number.
    is_durable: bool = False
    is_granted: bool = False
    #: The end of the last reservation: its holder, the reason, and the time.
    ended: tuple[StartKey, str, float] | None = None
    queue: deque[_Waiting] = field(default_factory=deque)
    #: Calls that have waited for the maximum time, until they are repeated.
    late_starts: set[StartKey] = field(default_factory=set)

    def queue_entry(self, start: StartKey) -> _Waiting | None:
        """The entry of a coordinator in the queue."""
        return next((waiting for waiting in self.queue if waiting.start == start), None)

    def can_be_replaced_by(self, start: StartKey) -> bool:
        """Whether this start, or an earlier start of the same coordinator, holds the resource."""
        return self.holder is not None and self.holder[0] == start[0] and self.holder[1] <= start[1]

    def is_claimed_earlier(self, start: StartKey) -> bool:
        """Whether an earlier request waits for the resource to be free."""
        ahead = takewhile(lambda waiting: waiting.start != start, self.queue)
        return any(waiting.purpose == "take" for waiting in ahead)


class Reservations:
    """The reservations of one host's resources.

    `first` is a number that no earlier incarnation of this host can have given out, for a resource without a
    record. `wait` returns the seconds for which others wait for a resource; `busy(resource, agent)` returns
    whether a portal call of a coordinator other than `agent` is under way in it.
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

    def restore(self, resource: str, number: int, holder: StartKey | None, now: float) -> None:
        """Restore a record from before a restart: its holder keeps the reservation for one lease."""
        found = self._resources[resource] = _Resource(number, holder, now, now + self._lease)
        found.is_durable = found.is_granted = holder is not None

    # --- effects --------------------------------------------------------------------------------------

    def drain_effects(self) -> list[Effect]:
        """The pending effects, in order; each is returned once."""
        effects, self._effects = self._effects, []
        return effects

    @property
    def due(self) -> float | None:
        """The time when `tick` is due next, None for never."""
        return min(self._dues(), default=None)

    def _dues(self) -> Iterator[float]:
        for found in self._resources.values():
            if found.holder is not None and found.is_durable:
                yield found.until
            yield from (waiting.deadline for waiting in found.queue)

    @property
    def held(self) -> Mapping[str, HeldReservation]:
        """The present reservations, by resource."""
        return {name: held for name in self._resources if (held := self.holder_of(name)) is not None}

    @property
    def known(self) -> Collection[str]:
        """The resources that were ever reserved, or requested."""
        return self._resources

    def is_contended(self, resource: str) -> bool:
        """Whether calls of a resource need permission because it is reserved or requested."""
        found = self._resources.get(resource)
        return found is not None and (
            found.holder is not None or bool(found.queue) or bool(found.late_starts)
        )

    def holder_of(self, resource: str) -> HeldReservation | None:
        """The reservation of a resource; None if it is free."""
        found = self._resources.get(resource)
        if found is None or found.holder is None:
            return None
        return HeldReservation(resource, found.number, found.holder, found.since, found.until)

    def waits_for(self, start: StartKey) -> str:
        """The resource that a coordinator waits for, '' for none."""
        return next((name for name, found in self._resources.items() if found.queue_entry(start)), "")

    # --- requests of coordinators ---------------------------------------------------------------------

    def acquire(self, start: StartKey, resource: str, now: float, *, nested: bool) -> int:
        """Reserve a resource: the number, 0 if the coordinator has to wait. Raises ReservationDenied.

        A later start of a coordinator takes over the reservation of an earlier one. A holder that requests
        again gets a new number: messages about the old one may be in transit.
        """
        reservation = self._find(resource, now)
        if reservation.holder == start and not reservation.is_granted:
            reservation.is_granted, reservation.until = reservation.is_durable, now + self._lease
            return reservation.number if reservation.is_durable else 0
        free = reservation.holder is None and not reservation.queue and not self._busy(resource, start[0])
        if free or reservation.can_be_replaced_by(start):
            self._grant(resource, reservation, start, now)
        elif nested or self._wait(resource) <= 0:
            raise ReservationDenied(RESERVED, self._denial_text(resource, reservation, now, start))
        else:
            self._queue_up(reservation, _Waiting(start, "take", now + self._wait(resource)))
        return 0

    def may_serve(
        self, start: StartKey, resource: str, number: int, now: float, *, nested: bool = False
    ) -> bool:
        """Whether a portal call may start for the coordinator with this number (0: none); otherwise the call
        waits.

        Raises ReservationDenied, immediately for a coordinator with another reservation (`nested`) that would
        have to wait. A holder that calls without the number has left its block, and the release message was
        lost or is in transit.
        """
        reservation = self._find(resource, now)
        if number:
            if reservation.holder != start or reservation.number != number:
                raise ReservationDenied(LOST, self._loss_reason(resource, reservation, start, number, now))
            reservation.until = now + self._lease
            return True
        if reservation.holder == start and reservation.is_granted:
            self._end(resource, reservation, "it has left the block", now)
        if reservation.holder is None and not reservation.is_claimed_earlier(start):
            self._leave_queue(reservation, start)
            return True
        if start in reservation.late_starts or nested or self._wait(resource) <= 0:
            self._leave_queue(reservation, start)
            raise ReservationDenied(RESERVED, self._denial_text(resource, reservation, now, start))
        self._queue_up(reservation, _Waiting(start, "call", now + self._wait(resource)))
        return False

    def abandon_wait(self, start: StartKey, now: float) -> bool:
        """Cancel a coordinator's wait; False if it did not wait."""
        waited = False
        for resource, found in self._resources.items():
            waited = self._leave_queue(found, start) or waited
            if found.holder == start and not found.is_granted:
                waited = True
                self._end(resource, found, "its wait was cancelled", now)
        return waited

    # --- reports of holders ---------------------------------------------------------------------------

    def renew(self, start: StartKey, resource: str, number: int, now: float) -> None:
        """The holder is alive, and in its block."""
        found = self._find(resource, now)
        if found.holder == start and found.number == number:
            found.until = max(found.until, now + self._lease)

    def release(self, resource: str, number: int, now: float) -> None:
        """The holder has left its block."""
        found = self._find(resource, now)
        if found.holder is not None and found.number == number and found.is_granted:
            self._end(resource, found, "it has left the block", now)

    def on_start_ended(self, start: StartKey, reason: str, now: float) -> None:
        """A start may not act any more: it has terminated, or is fenced."""
        for resource, found in self._resources.items():
            self._leave_queue(found, start)
            if found.holder == start:
                self._end(resource, found, reason, now)

    @property
    def concerned(self) -> set[StartKey]:
        """All coordinators that hold or await a resource."""
        holders = {found.holder for found in self._resources.values() if found.holder is not None}
        return holders | {waiting.start for found in self._resources.values() for waiting in found.queue}

    @property
    def unwritten(self) -> list[tuple[str, StartKey]]:
        """The reservations that wait for their record to be on disk."""
        return [(n, f.holder) for n, f in self._resources.items() if f.holder and not f.is_durable]

    # --- disk and time --------------------------------------------------------------------------------

    def on_durable(self, resource: str, number: int, now: float) -> None:
        """The record of a holder is on disk: the holder may receive its number."""
        found = self._resources[resource]
        if found.holder is not None and found.number == number and not found.is_durable:
            found.is_durable, found.until = True, now + self._lease
            self._effects.append(RetryWaiter(found.holder))

    def tick(self, now: float) -> None:
        """Time has passed, or a portal call has ended: serve the queues."""
        for resource, reservation in self._resources.items():
            self._expire(resource, reservation, now)
            for waiting in [waiting for waiting in reservation.queue if waiting.deadline <= now]:
                message = self._denial_text(resource, reservation, now, waiting.start)
                self._leave_queue(reservation, waiting.start)
                if waiting.purpose == "take":
                    self._effects.append(DenyWaiter(waiting.start, resource, message))
                elif not waiting.may_proceed:
                    reservation.late_starts.add(waiting.start)
                    self._effects.append(RetryWaiter(waiting.start))
            self._advance_queue(resource, reservation, now)

    def postpone(self, now: float) -> None:
        """The host was stalled: restart all time-outs of holders and waiting coordinators."""
        for resource, found in self._resources.items():
            deadline = now + self._wait(resource)
            found.until = max(found.until, now + self._lease)
            found.queue = deque(replace(each, deadline=deadline) for each in found.queue)

    # --- state changes --------------------------------------------------------------------------------

    def _find(self, resource: str, now: float) -> _Resource:
        if resource not in self._resources:
            self._resources[resource] = _Resource(self._first)
        found = self._resources[resource]
        self._expire(resource, found, now)
        return found

    def _expire(self, resource: str, found: _Resource, now: float) -> None:
        if found.holder is not None and found.is_durable and found.until <= now:
            self._end(resource, found, "its lease has expired", now)

    def _grant(self, resource: str, found: _Resource, start: StartKey, now: float) -> None:
        if found.holder is not None:
            found.ended = found.holder, "a later start reserved it", now
            if not found.is_granted:
                message = f"{resource} is reserved by a later start of {start[0]}"
                self._effects.append(DenyWaiter(found.holder, resource, message))
        self._leave_queue(found, start)
        found.number, found.holder = found.number + 1, start
        found.since, found.until, found.is_durable, found.is_granted = now, now + self._lease, False, False
        self._effects.append(PersistHolder(resource, found.number, start, is_lazy=False))

    def _end(self, resource: str, found: _Resource, reason: str, now: float) -> None:
        assert found.holder is not None
        found.ended, found.holder = (found.holder, reason, now), None
        self._effects.append(PersistHolder(resource, found.number, None, is_lazy=True))
        self._advance_queue(resource, found, now)

    def _advance_queue(self, resource: str, reservation: _Resource, now: float) -> None:
        """Resume the first in the queue: a call at once, a reservation when no other call is under way."""
        for place, waiting in enumerate(reservation.queue):
            if reservation.holder is not None:
                return
            if waiting.purpose == "take":
                if place == 0 and not self._busy(resource, waiting.start[0]):
                    self._grant(resource, reservation, waiting.start, now)
                return
            if not waiting.may_proceed:
                reservation.queue[place] = replace(waiting, deadline=now + PREEMPT_AFTER, may_proceed=True)
                self._effects.append(RetryWaiter(waiting.start))

    def _queue_up(self, found: _Resource, waiting: _Waiting) -> None:
        before = found.queue_entry(waiting.start)
        if before is not None and (before.purpose != waiting.purpose or before.may_proceed):
            found.queue.remove(before)
            before = None
        if before is None:
            found.queue.append(waiting)

    def _leave_queue(self, found: _Resource, start: StartKey) -> bool:
        found.late_starts.discard(start)
        place = found.queue_entry(start)
        if place is not None:
            found.queue.remove(place)
        return place is not None

    # --- messages -------------------------------------------------------------------------------------

    def _denial_text(self, resource: str, found: _Resource, now: float, start: StartKey) -> str:
        """The reason why a coordinator cannot have a resource."""
        if found.holder is not None:
            return f"{resource} is {ReservedBy(found.holder[0], found.since).sentence(now)}"
        ahead = next((each for each in found.queue if each.purpose == "take" and each.start != start), None)
        if ahead is not None:
            return f"{resource} is about to be reserved by {ahead.start[0]}"
        return f"{resource} is executing calls of others, and can be reserved only after these"

    def _loss_reason(self, resource: str, found: _Resource, start: StartKey, number: int, now: float) -> str:
        """The reason why a number is not valid any more."""
        if found.holder is not None and found.holder != start:
            return f"{resource} was reserved by {found.holder[0]} {now - found.since:.1f} s ago"
        if found.ended is not None and found.ended[0] == start:
            _, reason, when = found.ended
            return f"the reservation of {resource} ended {now - when:.1f} s ago: {reason}"
        if found.holder is None and found.ended is not None and found.number > number:
            (other, _), _, when = found.ended
            return (
                f"{resource} was reserved by {other} since, and that reservation ended {now - when:.1f} s ago"
            )
        return f"{resource} is no longer reserved for {start[0]}: its host has no record of the reservation"
