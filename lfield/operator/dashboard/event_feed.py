"""The events of several teams as one ordered stream, for `lfield events` and `logs`.

An event is held back for `HOLD_TIME`, because events of other hosts with earlier timestamps may still arrive.
Lost events and unreachable hosts are reported in between as a `FeedNotice`.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from functools import partial
from pathlib import Path

from msgspec import Struct, field

from lfield.clock import Clock, SystemClock
from lfield.errors import LfieldError
from lfield.net.transport import Transport
from lfield.operator.client import SNAPSHOT, ask_all, observer_transport, own_keys, presented_crl
from lfield.operator.dashboard.event_stream.background_task import background_tasks
from lfield.operator.dashboard.event_stream.event_follower import (
    EventFollower,
    FollowOptions,
    StreamHandler,
)
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent, EventTimeline
from lfield.operator.observer_link import PresentedCrl
from lfield.operator.targets import HostRef, TargetTeam
from lfield.operator.team_model.log_buffer import MAX_LINES
from lfield.operator.team_model.mission_end import MissionEnd
from lfield.wire.subscription_messages import EventBatch

#: The kinds of events that make a log.
LOG_KINDS = frozenset({"printed", "logged", "skipped"})
#: Time-out (s) for the stored events of all hosts.
BACKLOG_TIMEOUT = 8.0

#: The kind of lost telemetry of unknown kinds and number.
TELEMETRY = "telemetry"

#: Seconds for which an event waits for earlier ones of other hosts, and between two checks.
HOLD_TIME, POLL_INTERVAL = 0.5, 0.1


class FeedNotice(Struct, frozen=True):
    """A notice about a host: events lost, by kind (None: unknown number), or the reason why it is
    unreachable.
    """

    host: str
    text: str
    lost: Mapping[str, int | None] = field(default_factory=dict)


class TeamFeed:
    """The hosts of one team; `names` are their display names. Implements `StreamHandler`.

    `telemetry`: subscribed, so its loss is reported. `kinds` are the kinds to keep, None for all. The
    `observer` is called like this handler.
    """

    def __init__(
        self,
        names: Mapping[str, str],
        clock: Clock,
        *,
        telemetry: bool = False,
        kinds: Collection[str] | None = None,
        observer: StreamHandler | None = None,
    ) -> None:
        self._names, self._clock, self._telemetry, self._kinds = names, clock, telemetry, kinds
        self._observer = observer
        self._timeline = EventTimeline()
        self._notices: list[FeedNotice] = []
        self._unreached_reasons: dict[str, str] = {}
        self._incarnations: dict[str, int] = {}
        #: The hosts whose link was lost.
        self._cut: set[str] = set()
        #: For each host the number of its newest event at first contact, and of the newest received.
        self._initial_latest: dict[str, int] = {}
        self._received: dict[str, int] = {}

    def on_linked(self, host: str) -> None:
        """See `StreamHandler.on_linked`."""
        if self._observer is not None:
            self._observer.on_linked(host)
        if self._unreached_reasons.pop(host, None) is not None:
            self._notices.append(FeedNotice(self._names[host], "reachable again"))

    def on_unlinked(self, host: str, reason: str) -> None:
        """See `StreamHandler.on_unlinked`: one notice for each reason."""
        if self._observer is not None:
            self._observer.on_unlinked(host, reason)
        if host in self._incarnations:
            self._cut.add(host)
        if self._unreached_reasons.get(host) != reason:
            self._unreached_reasons[host] = reason
            self._notices.append(FeedNotice(self._names[host], f"unreachable: {reason}"))

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """See `StreamHandler.on_batch`."""
        if self._observer is not None:
            self._observer.on_batch(host, batch, took)
        name, now = self._names[host], self._clock.monotonic()
        if self._incarnations.setdefault(host, batch.incarnation) != batch.incarnation:
            self._incarnations[host] = batch.incarnation
            self._notices.append(FeedNotice(name, "restarted"))
        elif host in self._cut and self._telemetry:
            text = "telemetry was lost while it was unreachable, unknown how much"
            self._notices.append(FeedNotice(name, text, {TELEMETRY: None}))
        self._cut.discard(host)
        for event in batch.events:
            if self._kinds is None or event.kind in self._kinds:
                self._timeline.add(host, batch.incarnation, event, now)
        if batch.lost:
            kinds = ", ".join(f"{count} of kind '{kind}'" for kind, count in batch.lost.items())
            self._notices.append(FeedNotice(name, f"events were lost: {kinds}", batch.lost))
        self._initial_latest.setdefault(host, batch.latest)
        last = max((event.number for event in batch.events), default=0)
        self._received[host] = max(self._received.get(host, 0), batch.after, last)

    @property
    def is_complete(self) -> bool:
        """Whether every reachable host has sent all events that it had at first contact."""
        return all(self._is_caught_up(host) or host in self._unreached_reasons for host in self._names)

    def _is_caught_up(self, host: str) -> bool:
        return host in self._initial_latest and self._received[host] >= self._initial_latest[host]

    @property
    def unreached(self) -> Mapping[str, str]:
        """The hosts whose stored events were not received completely, each with the reason."""
        missed = [host for host in self._names if not self._is_caught_up(host)]
        return {
            self._names[host]: self._unreached_reasons.get(host, "the host has not sent all stored events")
            for host in missed
        }

    def drain_items(self, *, everything: bool = False) -> list[DatedEvent | FeedNotice]:
        """The items that are due now; with `everything` all."""
        notices, self._notices = self._notices, []
        dated_events = self._timeline.drain_events(
            None if everything else self._clock.monotonic() - HOLD_TIME
        )
        return [*notices, *(dated._replace(host=self._names[dated.host]) for dated in dated_events)]


#: Requests the state of all hosts of a team.
SnapshotQuery = Callable[[], Awaitable[Mapping[str, EventBatch | LfieldError]]]


class EventFeed:
    """The hosts of several teams. `query` requests snapshots."""

    def __init__(self, parts: Sequence[TeamFeed], query: SnapshotQuery | None = None) -> None:
        self._feeds, self._query = parts, query

    async def events(
        self, *, follow: bool, until: Callable[[], bool] = lambda: False
    ) -> AsyncIterator[DatedEvent | FeedNotice]:
        """The events until the feed is closed or `until` is true; without `follow` only the stored ones."""
        while True:
            is_over = until()
            if is_over:
                # The other hosts may have more to send.
                await asyncio.sleep(HOLD_TIME)
            is_last = is_over or (not follow and all(part.is_complete for part in self._feeds))
            for item in self.remaining() if is_last else self._drain_items():
                yield item
            if is_last:
                return
            await asyncio.sleep(POLL_INTERVAL)

    def _drain_items(self) -> list[DatedEvent | FeedNotice]:
        return [item for part in self._feeds for item in part.drain_items()]

    def remaining(self) -> list[DatedEvent | FeedNotice]:
        """The items that are still held back."""
        return [item for part in self._feeds for item in part.drain_items(everything=True)]

    async def snapshots(self) -> Mapping[str, EventBatch | LfieldError]:
        """The state of every host of a single team, requested now, by name."""
        assert self._query is not None, "the feed of one team"
        return await self._query()

    async def follow_end(self, end: MissionEnd) -> None:
        """Queries the hosts of a single team whenever a query is due, until their mission has ended."""
        while not end.is_over():
            if end.is_query_due:
                end.on_answers(await self.snapshots())
            end.check()
            await asyncio.sleep(POLL_INTERVAL)

    @property
    def unreached(self) -> Mapping[str, str]:
        """The hosts whose stored events were not received completely, each with the reason."""
        return {host: reason for part in self._feeds for host, reason in part.unreached.items()}


async def log_backlog(
    transport: Transport,
    hosts: Sequence[str],
    reach: Callable[[str], Awaitable[str]],
    clock: Clock,
    brings: PresentedCrl | None = None,
) -> list[DatedEvent]:
    """The newest stored log events of all hosts that are reachable within `BACKLOG_TIMEOUT`."""
    part = TeamFeed({host: host for host in hosts}, clock, kinds=LOG_KINDS)
    last: deque[DatedEvent] = deque(maxlen=MAX_LINES)
    with suppress(TimeoutError):
        async with (
            asyncio.timeout(BACKLOG_TIMEOUT),
            background_tasks(
                EventFollower(transport, hosts, reach, part, clock, FollowOptions(since=0, crl=brings)).run()
            ),
        ):
            async for item in EventFeed([part]).events(follow=False):
                last += [item] if isinstance(item, DatedEvent) else []
    return [*last, *(item for item in part.drain_items(everything=True) if isinstance(item, DatedEvent))]


@asynccontextmanager
async def open_feed(
    teams: Sequence[TargetTeam],
    names: Mapping[HostRef, str],
    find: Callable[[], Sequence[TargetTeam]],
    keys: Path | None = None,
    *,
    since: int | None = None,
    telemetry: float = 0.0,
    observer: StreamHandler | None = None,
) -> AsyncIterator[EventFeed]:
    """Follow the hosts that have a display name. `find` locates the teams again.

    The `observer` gets the batches of a single team, whose hosts it may query.
    `since` and `telemetry` (Hz): see `StreamCursor`. Raises KeysError for keys that cannot be used.
    """
    clock, parts, followers = SystemClock(), [], []
    query: SnapshotQuery | None = None
    own = own_keys([address for team in teams for address in team.addresses.values()], keys)
    transport, brings = observer_transport(own), presented_crl(own)
    for team in teams:
        called = {place.host: names[place] for place in team.host_refs if place in names}
        part = TeamFeed(called, clock, telemetry=telemetry > 0.0, observer=observer)
        reach = HostLocator(team, find)
        query = partial(_query_snapshots, transport, reach, brings)
        follower = EventFollower(
            transport,
            list(called),
            reach,
            part,
            clock,
            FollowOptions(since=since, telemetry=telemetry, crl=brings, hint=reach.hint),
        )
        parts.append(part)
        followers.append(follower.run())
    async with background_tasks(*followers):
        yield EventFeed(parts, query)


async def _query_snapshots(
    transport: Transport, reach: HostLocator, crl: PresentedCrl | None
) -> Mapping[str, EventBatch | LfieldError]:
    return await ask_all(transport, dict(reach.addresses), SNAPSHOT, crl)
