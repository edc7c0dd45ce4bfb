"""Event log of one incarnation of a host: numbered without a gap, in two bounded rings. Sans-IO.

Frequent events (those that a program can cause at any rate) have a ring of their own, so they do not displace
rare events: a subscriber that was disconnected for long still receives every latch, stop and link event, and
loses at most hops and output.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from heapq import merge
from operator import itemgetter

import msgspec

from lfield.hybrid_clock import counter_of, milliseconds_of
from lfield.wire import events
from lfield.wire.events import Event, StateEvent, TelemetryEvent

#: Capacity of the ring of frequent events: their number, and their bytes.
MAX_FREQUENT_EVENTS, MAX_FREQUENT_BYTES = 32768, 4 << 20
#: Capacity of the ring of rare events.
RARE_EVENTS, RARE_BYTES = 8192, 1 << 20
#: The frequent kinds: programs or callers of a host determine their rate.
FREQUENT = frozenset(
    {
        events.Printed,
        events.LineLogged,
        events.MigrationStarted,
        events.MigrationArrived,
        events.MigrationConfirmed,
        events.MigrationFailed,
        events.PortalCallStarted,
        events.PortalCallEnded,
        events.DeviceCallStarted,
        events.DeviceCallEnded,
        events.EventsDropped,
    }
)

#: An event by its number, with its encoded size.
LoggedEvent = tuple[int, int, Event]

_number = itemgetter(0)
_encode = msgspec.msgpack.Encoder().encode


def stamped_event(
    number: int, at: float, uptime: float, cause: int, content: StateEvent | TelemetryEvent, stamp: int
) -> Event:
    """An event with its timestamp; the other arguments are fields of it."""
    ahead = milliseconds_of(stamp) - int(at * 1000.0)
    return Event(number, at, uptime, cause, content, ahead, counter_of(stamp))


class EventRing:
    """The newest events of one class: bounded in number and bytes; the last one is always stored."""

    def __init__(self, max_events: int, max_bytes: int) -> None:
        self._max_events, self._free_bytes = max_events, max_bytes
        self._events: deque[LoggedEvent] = deque()
        #: The number of the newest dropped event, 0 for none.
        self.last_dropped = 0

    def append(self, number: int, size: int, event: Event) -> None:
        """Append an event with a higher number."""
        events = self._events
        events.append((number, size, event))
        self._free_bytes -= size
        while (self._free_bytes < 0 or len(events) > self._max_events) and len(events) > 1:
            self.last_dropped, its_size, _ = events.popleft()
            self._free_bytes += its_size

    def after(self, number: int) -> Iterator[LoggedEvent]:
        """The events with higher numbers, in order; read them before the next `append`."""
        events = self._events
        for n in range(bisect_right(events, number, key=_number), len(events)):
            yield events[n]


class EventLog:
    """Two rings with one numbering: frequent and rare events."""

    def __init__(self, frequent: EventRing | None = None, rare: EventRing | None = None) -> None:
        self._frequent = frequent or EventRing(MAX_FREQUENT_EVENTS, MAX_FREQUENT_BYTES)
        self._rare = rare or EventRing(RARE_EVENTS, RARE_BYTES)
        #: The number of the newest state event, 0 before the first.
        self.latest = 0

    @property
    def last_dropped(self) -> int:
        """The number of the newest dropped event: no later event is missing."""
        return max(self._frequent.last_dropped, self._rare.last_dropped)

    def append(self, content: StateEvent, at: float, uptime: float, cause: int = 0, stamp: int = 0) -> int:
        """Record an event, `at` Unix time, `uptime` seconds after the start of the host and with the
        timestamp `stamp`; returns its number."""
        self.latest = number = self.latest + 1
        event = stamped_event(number, at, uptime, cause, content, stamp)
        ring = self._frequent if type(content) in FREQUENT else self._rare
        ring.append(number, len(_encode(event)), event)
        return number

    def after(
        self, number: int, max_events: int, max_bytes: int, frequent_after: int = 0
    ) -> tuple[list[Event], int]:
        """The stored events after a number, at least one if there is any, and their bytes.

        Bounded in number and bytes; of frequent events only those after `frequent_after`.
        """
        found: list[Event] = []
        total = 0
        for _, size, event in merge(
            self._frequent.after(max(number, frequent_after)), self._rare.after(number)
        ):
            if len(found) == max_events or (found and total + size > max_bytes):
                break
            found.append(event)
            total += size
        return found, total


def size_of(event: Event) -> int:
    """The encoded size of an event."""
    return len(_encode(event))
