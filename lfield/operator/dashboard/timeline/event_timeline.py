"""Merges the events of many hosts into one order by their hybrid timestamps. Pure (decisions 65 and 92).

Events are ordered by (timestamp, host, number). A timestamp is greater than those of all causes, except
between hosts whose clocks differ by more than `lfield.hybrid_clock` follows. So the merge also keeps other
known causes: the numbers of an incarnation, later incarnations after earlier ones, and of a hop
`MigrationStarted` before `MigrationArrived` before `MigrationConfirmed`.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from lfield.hybrid_clock import milliseconds_of
from lfield.wire.events import Event, MigrationArrived, MigrationConfirmed, MigrationStarted

#: Maximum number of hops to remember.
MAX_HOPS = 1 << 16

HopKey = tuple[str, int, int]


class HostIncarnation(NamedTuple):
    """A host from one start to its end."""

    host: str
    incarnation: int


class Cause(NamedTuple):
    """An event by its host, incarnation and number."""

    host: str
    incarnation: int
    number: int


class DatedEvent(NamedTuple):
    """An event with its host and `cause` (None: unknown)."""

    host: str
    incarnation: int
    event: Event
    cause: Cause | None

    @property
    def time(self) -> float:
        """The time of its timestamp, in seconds since 1970."""
        return milliseconds_of(self.event.stamp) / 1000.0

    @property
    def within(self) -> float | None:
        """Seconds by which the timestamp is ahead of the clock of the host; None if it is not."""
        return self.event.ahead / 1000.0 if self.event.ahead > 0 else None


class _Waiting(NamedTuple):
    """An event that has not been given out; `received` is the monotonic time of its arrival, in seconds."""

    event: Event
    received: float


class EventTimeline:
    """Takes the events of each incarnation in their order, and those of several in any order."""

    def __init__(self) -> None:
        self._streams: dict[HostIncarnation, deque[_Waiting]] = {}
        #: The newest incarnation of each host, and the predecessor of each incarnation.
        self._newest: dict[str, HostIncarnation] = {}
        self._previous: dict[HostIncarnation, HostIncarnation] = {}
        #: The events that recorded the parts of hops, and the parts that wait here.
        self._hops: dict[tuple[str, HopKey], Cause] = {}
        self._waiting: set[tuple[str, HopKey]] = set()

    def add(self, host: str, incarnation: int, event: Event, received: float = 0.0) -> None:
        """Add the next event of an incarnation."""
        host_run = HostIncarnation(host, incarnation)
        stream = self._streams.get(host_run)
        if stream is None:
            stream = self._streams[host_run] = deque()
            if (before := self._newest.get(host)) is not None:
                self._previous[host_run] = before
                self._discard_if_over(before, host_run)
            self._newest[host] = host_run
        stream.append(_Waiting(event, received))
        if (key := hop_of(event)) is not None:
            part = event.kind, key
            self._waiting.add(part)
            self._hops[part] = Cause(host, incarnation, event.number)
            if len(self._hops) > 3 * MAX_HOPS:
                del self._hops[next(iter(self._hops))]

    def drain_events(self, received_by: float | None = None) -> list[DatedEvent]:
        """The events in their order, up to the last that was `received_by` that time; without it all.

        An event waits until then for others that may come before it.
        """
        found = []
        while self._is_due(received_by):
            found.append(self._next())
        return found

    def _is_due(self, received_by: float | None) -> bool:
        firsts = [stream[0].received for stream in self._streams.values() if stream]
        return bool(firsts) and (received_by is None or min(firsts) <= received_by)

    def _next(self) -> DatedEvent:
        free: list[tuple[int, HostIncarnation]] = []
        held: list[tuple[int, HostIncarnation]] = []
        for host_run, stream in self._streams.items():
            if stream:
                event = stream[0].event
                (held if self._must_wait(host_run, event) else free).append((event.stamp, host_run))
        # Damaged streams could have all events wait for one another.
        host_run = min(free or held)[1]
        event = self._streams[host_run].popleft().event
        self._discard_if_over(host_run, self._newest[host_run.host])
        cause = Cause(host_run.host, host_run.incarnation, event.cause) if event.cause else None
        key, after = hop_of(event), _FOLLOWS.get(type(event.what))
        if key is not None:
            self._waiting.discard((event.kind, key))
            if after is not None:
                cause = self._hops.get((after, key), cause)
        return DatedEvent(host_run.host, host_run.incarnation, event, cause)

    def _must_wait(self, host_run: HostIncarnation, event: Event) -> bool:
        if self._previous.get(host_run) in self._streams:
            return True
        key, after = hop_of(event), _FOLLOWS.get(type(event.what))
        return after is not None and key is not None and (after, key) in self._waiting

    def _discard_if_over(self, host_run: HostIncarnation, newest: HostIncarnation) -> None:
        """Forget an incarnation that has ended when all its events were given out."""
        if host_run != newest and not self._streams.get(host_run):
            self._streams.pop(host_run, None)
            self._previous.pop(host_run, None)


#: The event of the same hop that an event follows.
_FOLLOWS: dict[type, str] = {MigrationArrived: "left", MigrationConfirmed: "came"}


def hop_of(event: Event) -> HopKey | None:
    """The hop that an event is a part of, by the name that it has on both hosts; None for any other."""
    match event.what:
        case MigrationStarted() | MigrationArrived() | MigrationConfirmed():
            return (event.what.agent, event.what.generation, event.what.sequence)
        case _:
            return None
