"""How far along a motion is: whether it gets on, what is left of it, and when it is there. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield_mavlink.geo import Vector
from lfield_mavlink.setpoints.orders import Circle, Patience

#: Seconds that a rover stands until it is known to have stopped, and metres by which it may stop early.
STOPPED, EARLY = 1.0, 0.3
#: Metres from which ways are counted down whose end is not known.
FAR = 1e6


class Progress:
    """Whether a motion that began at `start` (on the clock), at `place`, still gets on."""

    def __init__(self, patience: Patience, start: float, place: Vector | None = None) -> None:
        self._patience, self._place = patience, place
        self._best, self._best_at, self._moved_at = math.inf, start, start

    def is_over(
        self, left: float, moves: bool, now: float, pace: float | None = None, place: Vector | None = None
    ) -> bool:
        """Take in what is left of the way, its speed and its place where known; whether all hope is gone."""
        if moves:
            self._moved_at = now
        if left < self._best - self._patience.closer:
            self._best, self._best_at = left, now
        waits = self._patience.bound(moves, pace)
        return now - self._best_at > waits or self._gone(place) > self._patience.room

    def _gone(self, place: Vector | None) -> float:
        """Metres over ground from where it began, as far as that is known."""
        if self._place is None or place is None:
            return 0.0
        return math.dist(self._place[:2], place[:2])

    def stood(self, now: float) -> float:
        """For how many seconds it has not moved."""
        return now - self._moved_at


class Arrival:
    """What is left of a way over ground, in metres; 0 when it stands within `radius` of its end.

    ArduPilot stops a rover where it is within WP_RADIUS of its goal, and comes no closer.
    """

    def __init__(self, radius: float, moves: Callable[[], bool], now: Callable[[], float]) -> None:
        self._radius, self._moves, self._now = radius, moves, now
        self._stood_since: float | None = None

    def left(self, far: float) -> float:
        """Of so many metres to its end."""
        if self._moves() or self._radius <= 0.0 or far > self._radius + EARLY:
            self._stood_since = None
        elif self._stood_since is None:
            self._stood_since = self._now()
        stands = self._stood_since is not None and self._now() - self._stood_since >= STOPPED
        return 0.0 if stands else far


class WayBack:
    """The way back of a flight that may first climb, as a number that only falls while it gets on."""

    #: Metres that are no noise: what hovers never adds them up.
    STEP = 0.3

    def __init__(self) -> None:
        self._moved = 0.0
        self._last: Vector | None = None

    def left(self, place: Vector) -> float:
        """Minus the metres flown so far: a return has a shape of its own, so any motion is progress."""
        step = 0.0 if self._last is None else math.dist(place, self._last)
        if self._last is None or step >= self.STEP:
            self._moved += step
            self._last = place
        return FAR - self._moved


#: Radians round a circle after which a vehicle is on it.
ONTO = 0.3


class Revolutions:
    """Counts the turns around a circle; `left` is the way still to go, in metres."""

    def __init__(self, circle: Circle, turns: float) -> None:
        self._circle, self._wanted = circle, turns * math.tau
        self._turned = 0.0
        self._last: float | None = None

    def left(self, place: Vector) -> float:
        """Metres to go, with the way onto the circle."""
        north, east = place[0] - self._circle.centre[0], place[1] - self._circle.centre[1]
        off = abs(math.hypot(north, east) - self._circle.radius)
        angle = math.atan2(east, north)
        if off > 0.5 * self._circle.radius:
            self._last = None
            return off + self._wanted * self._circle.radius
        if self._last is not None:
            step = math.remainder(angle - self._last, math.tau)
            self._turned += step if self._circle.clockwise else -step
        self._last = angle
        # Until it is under way round the circle it may still come closer to it.
        onto = off if self._turned < min(ONTO, self._wanted) else 0.0
        return onto + (self._wanted - self._turned) * self._circle.radius


class Turning:
    """Whether a frame turns at the rate that it is told again and again, by the heading that it tells.

    What steers like a car turns only while it drives. A rate is judged after JUDGED seconds, and once it
    should have turned by ENOUGH radians.
    """

    JUDGED, ENOUGH, SHARE = 2.0, 0.2, 0.25

    def __init__(self) -> None:
        self._since: float | None = None
        self._last_at = -math.inf
        self._rate = self._heading = 0.0

    def fails(self, rate: float, heading: float, gap: float, now: float) -> bool:
        """Take in that it is told a rate; whether the same rate has not turned it until now.

        After a `gap` of so many seconds it is told anew.
        """
        renewed = self._since is not None and rate == self._rate and now - self._last_at <= gap
        self._last_at = now
        if not renewed:
            self._since, self._rate, self._heading = now, rate, heading
        assert self._since is not None, "just set"
        should = abs(rate) * (now - self._since)
        if now - self._since < self.JUDGED or should < self.ENOUGH:
            return False
        turned = abs(math.remainder(heading - self._heading, math.tau))
        self._since = None
        return turned < self.SHARE * min(should, math.pi)


class Following:
    """Whether a vehicle follows velocities that it is told again and again, in m/s; judged after JUDGED s."""

    JUDGED, SHARE = 2.0, 1.0 / 3.0

    def __init__(self) -> None:
        self._since = self._last_at = -math.inf
        self._said = False

    def fails(self, asked: Vector, has: Vector, gap: float, now: float) -> bool:
        """Take in that it is told a velocity; whether it has hardly moved that way until now, once.

        After a `gap` of so many seconds it is told anew.
        """
        speed = math.hypot(*asked)
        along = sum(a * h for a, h in zip(asked, has, strict=True))
        renewed, self._last_at = now - self._last_at <= gap, now
        if not renewed or along >= self.SHARE * speed**2:
            self._since, self._said = now, False
        if self._said or now - self._since < self.JUDGED:
            return False
        self._said = True
        return True
