"""What happens on the hosts of teams, in one order and as it comes: what `lfield events` and `logs` print.

Events of hosts wait for a moment, so that what led to one on another host can come before it. What is lost,
and which hosts are not heard, comes in between as a `Notice`.
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
from lfield.operator.addressed import Party, Place
from lfield.operator.ask import brought, observer, own_keys
from lfield.operator.observing import Brought
from lfield.operator.sight.following.beside import beside
from lfield.operator.sight.following.follower import Follower
from lfield.operator.sight.following.reach import Reach
from lfield.operator.sight.picture.loglines import MOST_LINES
from lfield.operator.sight.timeline.clocks import WATCHER
from lfield.operator.sight.timeline.timeline import Dated, Timeline
from lfield.wire.watching import Events

#: The kinds of events that make a log.
SPOKEN = frozenset({"printed", "logged", "skipped"})
#: Seconds in which hosts have said what they said before.
PATIENT = 8.0

#: What telemetry of all kinds is called that is lost uncounted.
TELEMETRY = "telemetry"

#: For so many seconds an event waits for others that may have led to it, and how often it is looked.
HOLD, LOOK = 0.5, 0.1


@dataclass(frozen=True, slots=True)
class Notice:
    """Something about a host that is no event: what was lost, by kind, or why it is not heard.

    None is for what nobody has counted.
    """

    host: str
    text: str
    lost: Mapping[str, int | None] = field(default_factory=dict)


class Listening:
    """The hosts of one party; `names` is what each is called here. Implements `Hearer`.

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
        self._timeline = Timeline()
        #: By so much Unix time is ahead of the monotonic clock, here and as long as this lasts.
        self._ahead = clock.time() - clock.monotonic()
        self._timeline.clocks.wall(WATCHER, 0.0, self._ahead)
        self._notices: list[Notice] = []
        self._why: dict[str, str] = {}
        self._lives: dict[str, int] = {}
        #: The hosts that were heard, and then were not.
        self._cut: set[str] = set()
        #: For each host the number of its last state when it was first heard, and of the last that came.
        self._wanted: dict[str, int] = {}
        self._had: dict[str, int] = {}

    def linked(self, host: str) -> None:
        """See `Hearer.linked`."""
        if self._why.pop(host, None) is not None:
            self._notices.append(Notice(self._names[host], "it is heard again"))

    def unlinked(self, host: str, why: str) -> None:
        """See `Hearer.unlinked`: said once for each reason."""
        if host in self._lives:
            self._cut.add(host)
        if self._why.get(host) != why:
            self._why[host] = why
            self._notices.append(Notice(self._names[host], f"not heard: {why}"))

    def told(self, host: str, batch: Events, took: float | None) -> None:
        """See `Hearer.told`."""
        name, now = self._names[host], self._clock.monotonic()
        if self._lives.setdefault(host, batch.incarnation) != batch.incarnation:
            self._lives[host] = batch.incarnation
            self._notices.append(Notice(name, "it was started again"))
        elif host in self._cut and self._telemetry:
            text = "telemetry was lost while it was not heard, nobody knows how much"
            self._notices.append(Notice(name, text, {TELEMETRY: None}))
        self._cut.discard(host)
        asked = None if took is None else now - took
        self._timeline.heard(host, batch.incarnation, batch.up, now, asked)
        for event in batch.events:
            if self._kinds is None or event.kind in self._kinds:
                self._timeline.add(host, batch.incarnation, event)
        if batch.lost:
            words = ", ".join(f"{count} of kind '{kind}'" for kind, count in batch.lost.items())
            self._notices.append(Notice(name, f"events were lost: {words}", batch.lost))
        self._wanted.setdefault(host, batch.latest)
        last = max((event.number for event in batch.events), default=0)
        self._had[host] = max(self._had.get(host, 0), batch.after, last)

    @property
    def is_complete(self) -> bool:
        """Whether all that had happened when a host was first heard has come, of each that is heard now."""
        return all(self._has_told(host) or host in self._why for host in self._names)

    def _has_told(self, host: str) -> bool:
        return host in self._wanted and self._had[host] >= self._wanted[host]

    @property
    def unheard(self) -> Sequence[str]:
        """The hosts that were never heard, or not to the end of that."""
        return [name for host, name in self._names.items() if not self._has_told(host)]

    def given(self, *, everything: bool = False) -> list[Dated | Notice]:
        """What can be told now; with `everything` without waiting for anything more."""
        notices, self._notices = self._notices, []
        told = self._timeline.given(None if everything else self._clock.monotonic() + self._ahead - HOLD)
        return [*notices, *(dated._replace(host=self._names[dated.host]) for dated in told)]


class Ears:
    """The hosts of several parties at once."""

    def __init__(self, parts: Sequence[Listening]) -> None:
        self._parts = parts

    async def events(self, *, follow: bool) -> AsyncIterator[Dated | Notice]:
        """All that happens, until this is closed; without `follow` until all is told that had happened."""
        while True:
            is_last = not follow and all(part.is_complete for part in self._parts)
            for told in self.rest() if is_last else self._given():
                yield told
            if is_last:
                return
            await asyncio.sleep(LOOK)

    def _given(self) -> list[Dated | Notice]:
        return [told for part in self._parts for told in part.given()]

    def rest(self) -> list[Dated | Notice]:
        """What still waits for what may have led to it."""
        return [told for part in self._parts for told in part.given(everything=True)]

    @property
    def unheard(self) -> Sequence[str]:
        """The hosts that were never heard, or not to the end."""
        return [host for part in self._parts for host in part.unheard]


async def said_before(
    transport: Transport,
    hosts: Sequence[str],
    reach: Callable[[str], Awaitable[str]],
    clock: Clock,
    brings: Brought | None = None,
) -> list[Dated]:
    """The last that hosts have said until now, of those that can be heard within a few seconds."""
    part = Listening({host: host for host in hosts}, clock, kinds=SPOKEN)
    last: deque[Dated] = deque(maxlen=MOST_LINES)
    with suppress(TimeoutError):
        async with (
            asyncio.timeout(PATIENT),
            beside(Follower(transport, hosts, reach, part, clock, since=0, brings=brings).run()),
        ):
            async for told in Ears([part]).events(follow=False):
                last += [told] if isinstance(told, Dated) else []
    return [*last, *(told for told in part.given(everything=True) if isinstance(told, Dated))]


@asynccontextmanager
async def ears(
    parties: Sequence[Party],
    names: Mapping[Place, str],
    look: Callable[[], Sequence[Party]],
    keys: Path | None = None,
    *,
    since: int | None = None,
    telemetry: float = 0.0,
) -> AsyncIterator[Ears]:
    """Listen to those hosts of some parties that have names. `look` finds the parties anew.

    `since` and `telemetry` (Hz) as a `Cursor` has them. Raises KeysError for keys that cannot be used.
    """
    clock, parts, followers = SystemClock(), [], []
    own = own_keys([address for party in parties for address in party.addresses.values()], keys)
    transport, brings = observer(own), brought(own)
    for party in parties:
        called = {place.host: names[place] for place in party.places if place in names}
        part = Listening(called, clock, telemetry=telemetry > 0.0)
        reach = Reach(party, look)
        follower = Follower(
            transport,
            list(called),
            reach,
            part,
            clock,
            since=since,
            telemetry=telemetry,
            brings=brings,
            hint=reach.hint,
        )
        parts.append(part)
        followers.append(follower.run())
    async with beside(*followers):
        yield Ears(parts)
