"""The states that a host has told in this life: numbered without a gap, the newest of them kept. Pure.

What a program can do very often is kept apart from the rest, so it pushes out nothing that happens seldom:
whoever was away for long hears of every latch, stop and link, and what it has lost are hops and lines.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from heapq import merge
from operator import itemgetter

import msgspec

from lfield.wire import events
from lfield.wire.events import Event, State

#: How much is kept of what happens often, for watchers that were away: so many states, and bytes of them.
MOST_EVENTS, MOST_BYTES = 32768, 4 << 20
#: And of what happens seldom.
SELDOM_EVENTS, SELDOM_BYTES = 8192, 1 << 20
#: What happens as often as programs, or those who call a host, want it to.
OFTEN = frozenset(
    {
        events.Printed,
        events.Logged,
        events.Left,
        events.Came,
        events.Hopped,
        events.Stayed,
        events.Began,
        events.Ended,
        events.Asked,
        events.Answered,
        events.Skipped,
    }
)

#: An event by its number, with the bytes that it has in a message.
Kept = tuple[int, int, Event]

_number = itemgetter(0)
_encode = msgspec.msgpack.Encoder().encode


class Ring:
    """The newest events of one sort: so many, and so many bytes of them; the last, however large it is."""

    def __init__(self, most_events: int, most_bytes: int) -> None:
        self._most, self._room = most_events, most_bytes
        self._kept: deque[Kept] = deque()
        #: The number of the newest that was pushed out, 0 for none.
        self.forgotten = 0

    def keep(self, number: int, size: int, event: Event) -> None:
        """One more, with a higher number."""
        kept = self._kept
        kept.append((number, size, event))
        self._room -= size
        while (self._room < 0 or len(kept) > self._most) and len(kept) > 1:
            self.forgotten, its_size, _ = kept.popleft()
            self._room += its_size

    def after(self, number: int) -> Iterator[Kept]:
        """Those with higher numbers, in order; it is read before anything else is kept."""
        kept = self._kept
        for n in range(bisect_right(kept, number, key=_number), len(kept)):
            yield kept[n]


class Stream:
    """Two rings with one numbering: what happens often, and what happens seldom."""

    def __init__(self, often: Ring | None = None, seldom: Ring | None = None) -> None:
        self._often = often or Ring(MOST_EVENTS, MOST_BYTES)
        self._seldom = seldom or Ring(SELDOM_EVENTS, SELDOM_BYTES)
        #: The number of the newest state, 0 before the first.
        self.latest = 0

    @property
    def forgotten(self) -> int:
        """The number of the newest state that is kept no more: of what follows it nothing is missing."""
        return max(self._often.forgotten, self._seldom.forgotten)

    def tell(self, what: State, at: float, up: float, cause: int = 0) -> int:
        """Something has happened, `at` Unix time and `up` seconds after the host began; its number."""
        self.latest = number = self.latest + 1
        event = Event(number, at, up, cause, what)
        ring = self._often if type(what) in OFTEN else self._seldom
        ring.keep(number, len(_encode(event)), event)
        return number

    def after(
        self, number: int, most_events: int, most_bytes: int, often_after: int = 0
    ) -> tuple[list[Event], int]:
        """The states that follow a number and are kept, one at least if there is one, and their bytes.

        No more than so many, nor than so many bytes; of what happens often only what follows `often_after`.
        """
        found: list[Event] = []
        total = 0
        for _, size, event in merge(self._often.after(max(number, often_after)), self._seldom.after(number)):
            if len(found) == most_events or (found and total + size > most_bytes):
                break
            found.append(event)
            total += size
        return found, total


def size_of(event: Event) -> int:
    """The bytes that an event has in a message."""
    return len(_encode(event))
