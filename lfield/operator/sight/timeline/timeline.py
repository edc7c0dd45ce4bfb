"""Events of many hosts in one order, in which nothing comes before what led to it. Pure (decision 67).

Within a life of a host the numbers say the order, a hop leaves before it comes and comes before its sender
hears of it, and a life of a host follows the one before. All else goes by the clocks, as far as known.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from lfield.operator.sight.timeline.clocks import WATCHER, Clocks, Life, Placed
from lfield.wire.events import Came, Event, Hopped, Left

#: So many hops are remembered, and so many events wait for what may have led to them.
MOST_HOPS = MOST_WAITING = 1 << 16

Hop = tuple[str, int, int]


class Cause(NamedTuple):
    """An event by where it happened."""

    host: str
    incarnation: int
    number: int


class Dated(NamedTuple):
    """An event in its place.

    `time` is seconds since 1970 by the clock of whoever watches, or of one host that others are joined with;
    `within` is how sure that is (s), None where only its own host says it. It is never before the time of its
    `cause`, which is None where none is known.
    """

    host: str
    incarnation: int
    event: Event
    time: float
    within: float | None
    cause: Cause | None


@dataclass(slots=True)
class _Hop:
    left: tuple[Life, Event] | None = None
    came: tuple[Life, Event] | None = None
    heard: tuple[Life, Event] | None = None


@dataclass(slots=True)
class _Stream:
    waiting: deque[Event] = field(default_factory=deque)
    #: When the first of them was, as it was known when it became the first.
    first: Placed | None = None
    #: The time of the last one that was given out.
    last: float = 0.0
    #: The life of the same host before this one.
    earlier: Life | None = None


class Timeline:
    """Takes events of each life in their order, of all lives in any, and gives them out in one."""

    def __init__(self) -> None:
        self.clocks = Clocks()
        self._streams: dict[Life, _Stream] = {}
        self._newest: dict[str, Life] = {}
        self._hops: dict[Hop, _Hop] = {}
        #: The events that wait and that another one must follow, and the times of those that were given out.
        self._waiting: set[tuple[str, Hop]] = set()
        self._given: dict[tuple[str, Hop], float] = {}

    # --- in -------------------------------------------------------------------------------------------

    def heard(self, host: str, incarnation: int, up: float, now: float, asked: float | None) -> None:
        """A batch that was sent at `up` of its host's clock came `now` by the watcher's, who had `asked` for
        it then, if it did."""
        life = Life(host, incarnation)
        self.clocks.before((life, up), (WATCHER, now))
        if asked is not None:
            self.clocks.before((WATCHER, asked), (life, up))

    def add(self, host: str, incarnation: int, event: Event) -> None:
        """An event of a life of a host, the next one."""
        life = Life(host, incarnation)
        stream = self._streams.get(life)
        if stream is None:
            earlier = self._newest.get(host)
            stream = self._streams[life] = _Stream(earlier=earlier)
            self._newest[host] = life
            if earlier is not None and not self._streams[earlier].waiting:
                del self._streams[earlier]
        stream.waiting.append(event)
        self.clocks.wall(life, event.up, event.at)
        match event.what:
            case Left() | Came() | Hopped():
                self._learn(life, event)

    def _learn(self, life: Life, event: Event) -> None:
        """A part of a hop: what it says of clocks, and what must wait for what."""
        key = hop_of(event)
        assert key is not None, "whoever calls has looked"
        hop = self._hops.get(key)
        if hop is None:
            hop = self._hops[key] = _Hop()
            if len(self._hops) > MOST_HOPS:
                del self._hops[next(iter(self._hops))]
        match event.what:
            case Left():
                hop.left = (life, event)
                self._waiting.add(("left", key))
            case Came():
                hop.came = (life, event)
                self._waiting.add(("came", key))
            case _:
                hop.heard = (life, event)
        if hop.came is not None and not isinstance(event.what, Hopped):
            self._is_before(hop.left, hop.came)
        if hop.came is not None and not isinstance(event.what, Left):
            self._is_before(hop.came, hop.heard)

    def _is_before(self, one: tuple[Life, Event] | None, other: tuple[Life, Event] | None) -> None:
        if one is not None and other is not None:
            self.clocks.before((one[0], one[1].up), (other[0], other[1].up))

    # --- out ------------------------------------------------------------------------------------------

    def given(self, until: float | None = None) -> list[Dated]:
        """What can be told in its order now; with `until` only what happened by that time."""
        found = []
        if sum(len(stream.waiting) for stream in self._streams.values()) > MOST_WAITING:
            # A host whose events are of times that never come fills no memory.
            until = None
        while (dated := self._next(until)) is not None:
            found.append(dated)
        return found

    def _next(self, until: float | None) -> Dated | None:
        free: list[tuple[Placed, Life]] = []
        held: list[tuple[Placed, Life]] = []
        for life, stream in self._streams.items():
            if stream.waiting:
                event = stream.waiting[0]
                place = stream.first = stream.first or self.clocks.time(life, event.up)
                (held if self._must_wait(stream, event) else free).append((place, life))
        if not free and not held:
            return None
        # Hosts that contradict one another could have all of them wait for all others.
        place, life = min(free or held, key=lambda each: (each[0].time, each[1]))
        if until is not None and place.time > until:
            return None
        return self._give(life, place.time, place.within)

    def _must_wait(self, stream: _Stream, event: Event) -> bool:
        if stream.earlier in self._streams:
            # A life that is over goes when all of it was told.
            return True
        key, after = hop_of(event), _FOLLOWS.get(type(event.what))
        return after is not None and key is not None and (after, key) in self._waiting

    def _give(self, life: Life, time: float, within: float | None) -> Dated:
        stream = self._streams[life]
        event, stream.first = stream.waiting.popleft(), None
        if not stream.waiting and self._newest[life.host] != life:
            del self._streams[life]
        key, after = hop_of(event), _FOLLOWS.get(type(event.what))
        no_sooner = stream.last
        if key is not None and after is not None:
            no_sooner = max(no_sooner, self._given.get((after, key), 0.0))
        if time < no_sooner:
            within, time = (None if within is None else within + no_sooner - time), no_sooner
        stream.last = time
        cause = Cause(life.host, life.incarnation, event.cause) if event.cause else None
        if key is not None:
            cause = self._led_to(key, event) or cause
            self._gone(key, event, time)
        return Dated(life.host, life.incarnation, event, time, within, cause)

    def _led_to(self, key: Hop, event: Event) -> Cause | None:
        """What led to an event on another host."""
        hop = self._hops.get(key)
        match event.what:
            case Came():
                found = hop.left if hop is not None else None
            case Hopped():
                found = hop.came if hop is not None else None
            case _:
                found = None
        return None if found is None else Cause(found[0].host, found[0].incarnation, found[1].number)

    def _gone(self, key: Hop, event: Event, time: float) -> None:
        """Whoever waited for it waits no more."""
        kind = event.kind
        self._waiting.discard((kind, key))
        self._given[kind, key] = time
        if len(self._given) > 2 * MOST_HOPS:
            del self._given[next(iter(self._given))]


#: What an event follows of the same hop.
_FOLLOWS: dict[type, str] = {Came: "left", Hopped: "came"}


def hop_of(event: Event) -> Hop | None:
    """The hop that an event is a part of, by the name that it has on both hosts; None for any other."""
    match event.what:
        case Left() | Came() | Hopped():
            return (event.what.agent, event.what.generation, event.what.sequence)
        case _:
            return None
