"""Hops of coordinators as rows: the records of both hosts about a hop become one row. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from lfield.operator.dashboard.timeline.event_timeline import DatedEvent
from lfield.wire.events import MigrationArrived, MigrationConfirmed, MigrationFailed, MigrationStarted

HOP_COLUMNS = (
    *("agent", "generation", "sequence", "from", "to", "resource", "portal", "size [B]"),
    *("left", "arrived", "confirmed", "seconds [s]", "failed", "exception", "reason"),
)
#: The most hops that wait for an event of the other host.
MAX_OPEN = 1 << 16

HopKey = tuple[str, int, int]


class _Hop(Struct):
    source: str = ""
    target: str = ""
    resource: str = ""
    portal: str = ""
    size: int | None = None
    departed: float | None = None
    arrived: float | None = None
    confirmed: float | None = None
    seconds: float | None = None
    failed: float | None = None
    exception: str = ""
    reason: str = ""

    @property
    def is_complete(self) -> bool:
        """Whether no event of the hop is missing."""
        return self.failed is not None or None not in (self.departed, self.arrived, self.confirmed)


class HopRows:
    """The hops of a stream."""

    def __init__(self) -> None:
        self._open: dict[HopKey, _Hop] = {}

    def rows(self, dated: DatedEvent) -> Iterator[tuple[object, ...]]:
        """The row of a hop that is complete with an event."""
        event = dated.event.what
        if not isinstance(event, MigrationStarted | MigrationArrived | MigrationConfirmed | MigrationFailed):
            return
        key = event.agent, event.generation, event.sequence
        hop = self._open.setdefault(key, _Hop())
        _add(hop, dated)
        if hop.is_complete:
            yield _row(key, self._open.pop(key))
        elif len(self._open) > MAX_OPEN:
            oldest = next(iter(self._open))
            yield _row(oldest, self._open.pop(oldest))

    def remaining(self) -> Iterator[tuple[object, ...]]:
        """The rows of hops of which an event is missing."""
        for key, hop in self._open.items():
            yield _row(key, hop)
        self._open.clear()


def _add(hop: _Hop, dated: DatedEvent) -> None:
    match dated.event.what:
        case MigrationStarted(_, _, _, to, resource, portal, size):
            hop.source, hop.target, hop.resource, hop.portal = dated.host, to, resource, portal
            hop.size, hop.departed = size, dated.time
        case MigrationArrived(_, _, _, of, size):
            hop.source, hop.target, hop.size, hop.arrived = of, dated.host, size, dated.time
        case MigrationConfirmed(_, _, _, to, seconds):
            hop.source, hop.target, hop.confirmed, hop.seconds = dated.host, to, dated.time, seconds
        case MigrationFailed(_, _, _, to, exception, reason):
            hop.source, hop.target = dated.host, to or hop.target
            hop.failed, hop.exception, hop.reason = dated.time, exception, reason


def _row(key: HopKey, hop: _Hop) -> tuple[object, ...]:
    times = (f"{time:.6f}" if time is not None else "" for time in (hop.departed, hop.arrived, hop.confirmed))
    failed = f"{hop.failed:.6f}" if hop.failed is not None else ""
    place = (*key, hop.source, hop.target, hop.resource, hop.portal, hop.size)
    return (*place, *times, hop.seconds, failed, hop.exception, hop.reason)
