"""What happens on the hosts of teams, in one order and as it comes: what `lfield events` and `logs` print.

An event waits for a moment, since events of other hosts with earlier timestamps may arrive meanwhile. Lost
events and unreachable hosts are reported in between as a `FeedNotice`.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from lfield.clock import Clock, SystemClock
from lfield.net.transport import Transport
from lfield.operator.client import observer_transport, own_keys, presented_crl
from lfield.operator.dashboard.event_stream.background_task import background_tasks
from lfield.operator.dashboard.event_stream.event_follower import EventFollower, FollowOptions
from lfield.operator.dashboard.event_stream.host_locator import HostLocator
from lfield.operator.dashboard.timeline.event_timeline import DatedEvent, EventTimeline
from lfield.operator.observer_link import PresentedCrl
from lfield.operator.targets import HostRef, TargetTeam
from lfield.operator.team_model.log_buffer import MAX_LINES
from lfield.wire.subscription_messages import EventBatch

#: The kinds of events that make a log.
LOG_KINDS = frozenset({"printed", "logged", "skipped"})
#: Seconds in which hosts have said what they said before.
BACKLOG_TIMEOUT = 8.0

#: What telemetry of all kinds is called that is lost uncounted.
TELEMETRY = "telemetry"

#: Seconds for which an event waits for earlier ones of other hosts, and between two checks.
HOLD_TIME, POLL_INTERVAL = 0.5, 0.1


@dataclass(frozen=True, slots=True)
class FeedNotice:
    """Something about a host that is no event: what was lost, by kind, or why it is not heard.

    None is for what nobody has counted.
    """

    host: str
    text: str
    lost: Mapping[str, int | None] = field(default_factory=dict)


class TeamFeed:
    """The hosts of one party; `names` is what each is called here. Implements `StreamHandler`.

    `telemetry`: it is wanted, so it is said when some was lost. `kinds` are the events that are wanted, None
    for all.
    """

    def __init__(
        self,
        names: Mapping[str, str],
        clock: Clock,
        *,
        telemetry: bool = False,
        kinds: Collection[str] | None = None,
    ) -> None:
        self._names, self._clock, self._telemetry, self._kinds = names, clock, telemetry, kinds
        self._timeline = EventTimeline()
        self._notices: list[FeedNotice] = []
        self._why: dict[str, str] = {}
        self._incarnations: dict[str, int] = {}
        #: The hosts that were heard, and then were not.
        self._cut: set[str] = set()
        #: For each host the number of its last state when it was first heard, and of the last that came.
        self._initial_latest: dict[str, int] = {}
        self._received: dict[str, int] = {}

    def on_linked(self, host: str) -> None:
        """See `StreamHandler.on_linked`."""
        if self._why.pop(host, None) is not None:
            self._notices.append(FeedNotice(self._names[host], "it is heard again"))

    def on_unlinked(self, host: str, why: str) -> None:
        """See `StreamHandler.on_unlinked`: said once for each reason."""
        if host in self._incarnations:
            self._cut.add(host)
        if self._why.get(host) != why:
            self._why[host] = why
            self._notices.append(FeedNotice(self._names[host], f"not heard: {why}"))

    def on_batch(self, host: str, batch: EventBatch, took: float | None) -> None:
        """See `StreamHandler.on_batch`."""
        name, now = self._names[host], self._clock.monotonic()
        if self._incarnations.setdefault(host, batch.incarnation) != batch.incarnation:
            self._incarnations[host] = batch.incarnation
            self._notices.append(FeedNotice(name, "it was started again"))
        elif host in self._cut and self._telemetry:
            text = "telemetry was lost while it was unreachable, unknown how much"
            self._notices.append(FeedNotice(name, text, {TELEMETRY: None}))
        self._cut.discard(host)
        for event in batch.events:
            if self._kinds is None or event.kind in self._kinds:
                self._timeline.add(host, batch.incarnation, event, now)
        if batch.lost:
            words = ", ".join(f"{count} of kind '{kind}'" for kind, count in batch.lost.items())
            self._notices.append(FeedNotice(name, f"events were lost: {words}", batch.lost))
        self._initial_latest.setdefault(host, batch.latest)
        last = max((event.number for event in batch.events), default=0)
        self._received[host] = max(self._received.get(host, 0), batch.after, last)

    @property
    def is_complete(self) -> bool:
        """Whether all that had happened when a host was first heard has come, of each that is heard now."""
        return all(self._is_caught_up(host) or host in self._why for host in self._names)

    def _is_caught_up(self, host: str) -> bool:
        return host in self._initial_latest and self._received[host] >= self._initial_latest[host]

    @property
    def unreached(self) -> Sequence[str]:
        """The hosts that were never heard, or not to the end of that."""
        return [name for host, name in self._names.items() if not self._is_caught_up(host)]

    def drain_items(self, *, everything: bool = False) -> list[DatedEvent | FeedNotice]:
        """What can be told now; with `everything` without waiting for anything more."""
        notices, self._notices = self._notices, []
        told = self._timeline.drain_events(None if everything else self._clock.monotonic() - HOLD_TIME)
        return [*notices, *(dated._replace(host=self._names[dated.host]) for dated in told)]


class EventFeed:
    """The hosts of several parties at once."""

    def __init__(self, parts: Sequence[TeamFeed]) -> None:
        self._feeds = parts

    async def events(self, *, follow: bool) -> AsyncIterator[DatedEvent | FeedNotice]:
        """All that happens, until this is closed; without `follow` until all is told that had happened."""
        while True:
            is_last = not follow and all(part.is_complete for part in self._feeds)
            for told in self.remaining() if is_last else self._drain_items():
                yield told
            if is_last:
                return
            await asyncio.sleep(POLL_INTERVAL)

    def _drain_items(self) -> list[DatedEvent | FeedNotice]:
        return [told for part in self._feeds for told in part.drain_items()]

    def remaining(self) -> list[DatedEvent | FeedNotice]:
        """What still waits for what may have led to it."""
        return [told for part in self._feeds for told in part.drain_items(everything=True)]

    @property
    def unreached(self) -> Sequence[str]:
        """The hosts that were never heard, or not to the end."""
        return [host for part in self._feeds for host in part.unreached]


async def log_backlog(
    transport: Transport,
    hosts: Sequence[str],
    reach: Callable[[str], Awaitable[str]],
    clock: Clock,
    brings: PresentedCrl | None = None,
) -> list[DatedEvent]:
    """The last that hosts have said until now, of those that can be heard within a few seconds."""
    part = TeamFeed({host: host for host in hosts}, clock, kinds=LOG_KINDS)
    last: deque[DatedEvent] = deque(maxlen=MAX_LINES)
    with suppress(TimeoutError):
        async with (
            asyncio.timeout(BACKLOG_TIMEOUT),
            background_tasks(
                EventFollower(transport, hosts, reach, part, clock, FollowOptions(since=0, crl=brings)).run()
            ),
        ):
            async for told in EventFeed([part]).events(follow=False):
                last += [told] if isinstance(told, DatedEvent) else []
    return [*last, *(told for told in part.drain_items(everything=True) if isinstance(told, DatedEvent))]


@asynccontextmanager
async def open_feed(
    teams: Sequence[TargetTeam],
    names: Mapping[HostRef, str],
    find: Callable[[], Sequence[TargetTeam]],
    keys: Path | None = None,
    *,
    since: int | None = None,
    telemetry: float = 0.0,
) -> AsyncIterator[EventFeed]:
    """Listen to those hosts of some parties that have names. `find` finds the parties anew.

    `since` and `telemetry` (Hz) as a `StreamCursor` has them. Raises KeysError for keys that cannot be used.
    """
    clock, parts, followers = SystemClock(), [], []
    own = own_keys([address for party in teams for address in party.addresses.values()], keys)
    transport, brings = observer_transport(own), presented_crl(own)
    for party in teams:
        called = {place.host: names[place] for place in party.host_refs if place in names}
        part = TeamFeed(called, clock, telemetry=telemetry > 0.0)
        reach = HostLocator(party, find)
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
        yield EventFeed(parts)
