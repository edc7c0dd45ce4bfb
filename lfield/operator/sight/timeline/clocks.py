"""How the clocks of hosts differ, from nothing but which of two things happened first. Pure.

That something on one host led to something on another bounds by how much their clocks differ, from one side;
something that led back bounds it from the other. So a hop that was confirmed says it to half of the time it
took, as NTP does. Clocks drift, so a bound grows wider with time; between two times at which the difference
was known it is drawn as a straight line.
"""

from __future__ import annotations

import heapq
import math
from bisect import bisect_left, insort
from dataclasses import dataclass, field
from typing import NamedTuple

#: The rates of two clocks differ by no more, as quartzes do: seconds in a second.
DRIFT = 2e-4
#: Of what is known of two clocks within so many seconds the best is kept.
BUCKET = 10.0


class Life(NamedTuple):
    """A life of a host, whose monotonic clock counts in one go; `incarnation` is 0 for whoever watches."""

    host: str
    incarnation: int = 0


#: Whoever watches. Where it has heard hosts itself, time is by its clock.
WATCHER = Life("")


class Placed(NamedTuple):
    """A time in seconds since 1970, and how sure it is; None where only the host's own clock says it."""

    time: float
    within: float | None


class _Sample(NamedTuple):
    """When one clock showed `at`, the other one showed `ahead` more, within so many seconds."""

    at: float
    ahead: float
    within: float


@dataclass(slots=True)
class _Pair:
    """What one clock shows more than another: `low` and `high` bound it, each with the time on the first."""

    low: tuple[float, float] | None = None
    high: tuple[float, float] | None = None
    samples: list[_Sample] = field(default_factory=list)

    def bound(self, at: float, ahead: float, *, is_low: bool) -> None:
        """At that time on the first clock the difference was at least, or at most, so much."""
        if is_low:
            self.low = _tighter(self.low, at, ahead, 1.0)
        else:
            self.high = _tighter(self.high, at, ahead, -1.0)
        if self.low is None or self.high is None:
            return
        low = self.low[1] - DRIFT * abs(at - self.low[0])
        high = self.high[1] + DRIFT * abs(at - self.high[0])
        if low > high:
            # A clock was set, or runs faster than any should: what was known before is worth nothing.
            self.low, self.high = ((at, ahead), None) if is_low else (None, (at, ahead))
            return
        self._keep(_Sample(at, (low + high) / 2.0, (high - low) / 2.0))

    def _keep(self, sample: _Sample) -> None:
        place = bisect_left(self.samples, (sample.at,))
        for near in (place - 1, place):
            if 0 <= near < len(self.samples) and _bucket(self.samples[near]) == _bucket(sample):
                if sample.within <= self.samples[near].within:
                    del self.samples[near]
                    break
                return
        insort(self.samples, sample)

    def ahead(self, at: float) -> tuple[float, float]:
        """The difference at a time on the first clock, and how sure it is."""
        place = bisect_left(self.samples, (at,))
        if place in (0, len(self.samples)):
            one = self.samples[min(place, len(self.samples) - 1)]
            return one.ahead, one.within + DRIFT * abs(at - one.at)
        before, after = self.samples[place - 1], self.samples[place]
        share = (at - before.at) / (after.at - before.at) if after.at > before.at else 0.0
        away = min(at - before.at, after.at - at)
        ahead = before.ahead + share * (after.ahead - before.ahead)
        return ahead, before.within + share * (after.within - before.within) + DRIFT * away

    @property
    def best(self) -> float:
        """How well it was ever known (s)."""
        return min((sample.within for sample in self.samples), default=math.inf)


def _tighter(known: tuple[float, float] | None, at: float, ahead: float, sign: float) -> tuple[float, float]:
    """The better of a bound from before, which grew wider, and of a new one."""
    if known is not None and sign * known[1] - DRIFT * abs(at - known[0]) >= sign * ahead:
        return known
    return (at, ahead)


def _bucket(sample: _Sample) -> float:
    return sample.at // BUCKET


class Clocks:
    """The clocks of all lives. What a clock shows is seconds of its monotonic clock."""

    def __init__(self) -> None:
        self._pairs: dict[tuple[Life, Life], _Pair] = {}
        self._walls: dict[Life, float] = {}
        #: From each life the way to the one by whose clock its time is told; None when that has changed.
        self._ways: dict[Life, tuple[Life, ...]] | None = None

    def wall(self, life: Life, up: float, at: float) -> None:
        """A life's own Unix time. What it said last counts: a robot's clock is set when it finds somebody."""
        if life not in self._walls:
            self._ways = None
        self._walls[life] = at - up

    def before(self, earlier: tuple[Life, float], later: tuple[Life, float]) -> None:
        """What happened at a time of one clock led to what happened at a time of another."""
        (one, up), (other, then) = earlier, later
        if one == other:
            return
        key = (one, other) if one < other else (other, one)
        pair = self._pairs.get(key)
        if pair is None:
            pair = self._pairs[key] = _Pair()
        had = pair.best
        if key[0] == one:
            # When the first clock showed `up`, the second had not yet shown more than `then`.
            pair.bound(up, then - up, is_low=False)
        else:
            pair.bound(then, up - then, is_low=True)
        if pair.best < had:
            self._ways = None

    def time(self, life: Life, up: float) -> Placed:
        """When that was, what a life's clock showed."""
        ways = self._ways = self._found() if self._ways is None else self._ways
        within, here = 0.0, life
        for there in ways.get(life, ()):
            up, unsure = self._shown(here, there, up)
            within, here = within + unsure, there
        alone = here == life and here != WATCHER and not self._root_of_others(ways, life)
        return Placed(up + self._walls.get(here, 0.0), None if alone else within)

    def _root_of_others(self, ways: dict[Life, tuple[Life, ...]], life: Life) -> bool:
        return any(way and way[-1] == life for way in ways.values())

    def _shown(self, here: Life, there: Life, up: float) -> tuple[float, float]:
        """What another clock showed when this one showed `up`."""
        if here < there:
            ahead, within = self._pairs[here, there].ahead(up)
            return up + ahead, within
        pair = self._pairs[there, here]
        # What is known is by the other's clock: a first guess of that is good enough, clocks drift slowly.
        guess = up - pair.ahead(up)[0]
        ahead, within = pair.ahead(guess)
        return up - ahead, within

    def _found(self) -> dict[Life, tuple[Life, ...]]:
        """The surest way from each life to the watcher, or else to the first of those it is joined with."""
        near: dict[Life, list[tuple[Life, float]]] = {life: [] for life in self._walls}
        for (one, other), pair in self._pairs.items():
            if pair.samples:
                near.setdefault(one, []).append((other, pair.best))
                near.setdefault(other, []).append((one, pair.best))
        ways: dict[Life, tuple[Life, ...]] = {}
        roots = ([WATCHER] if WATCHER in near else []) + list(near)
        for root in roots:
            if root not in ways:
                _spread(root, near, ways)
        return ways


def _spread(
    root: Life, near: dict[Life, list[tuple[Life, float]]], ways: dict[Life, tuple[Life, ...]]
) -> None:
    """Dijkstra: the ways to a root from all that are joined with it."""
    queue: list[tuple[float, Life, tuple[Life, ...]]] = [(0.0, root, ())]
    while queue:
        unsure, life, way = heapq.heappop(queue)
        if life in ways:
            continue
        ways[life] = way
        for other, width in near[life]:
            if other not in ways:
                heapq.heappush(queue, (unsure + width, other, (life, *way)))
