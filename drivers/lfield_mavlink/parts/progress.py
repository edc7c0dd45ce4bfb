"""Progress of a motion: whether it advances, what remains, and when it has arrived. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield_mavlink.geodesy import Vector
from lfield_mavlink.setpoints.motion_orders import Circle, ProgressPatience

#: Seconds at rest until a rover has stopped, and metres by which it may stop early.
STOPPED, EARLY = 1.0, 0.3
#: Start value in metres for motions of unknown length.
FAR = 1e6


class Progress:
    """Progress of a motion that started at time `start`, at `place`."""

    def __init__(self, patience: ProgressPatience, start: float, place: Vector | None = None) -> None:
        self._patience, self._place = patience, place
        self._least_remaining, self._progress_at, self._moved_at = math.inf, start, start

    def is_over(
        self,
        remaining: float,
        is_moving: bool,
        now: float,
        speed: float | None = None,
        place: Vector | None = None,
    ) -> bool:
        """Adds the remaining distance, and speed and position if known; returns whether the motion has
        failed.
        """
        if is_moving:
            self._moved_at = now
        if remaining < self._least_remaining - self._patience.closer:
            self._least_remaining, self._progress_at = remaining, now
        time_limit = self._patience.bound(is_moving, speed)
        return (
            now - self._progress_at > time_limit
            or self._distance_from_start(place) > self._patience.clearance
        )

    def _distance_from_start(self, place: Vector | None) -> float:
        """Metres from the start of the motion, if known."""
        if self._place is None or place is None:
            return 0.0
        return math.dist(self._place[:2], place[:2])

    def rest_time(self, now: float) -> float:
        """Seconds since the vehicle last moved."""
        return now - self._moved_at


class Arrival:
    """The remaining distance in metres; 0 when it is at rest within `radius` of the goal.

    ArduPilot stops a rover within WP_RADIUS of its goal.
    """

    def __init__(self, radius: float, is_moving: Callable[[], bool], now: Callable[[], float]) -> None:
        self._radius, self._is_moving, self._now = radius, is_moving, now
        self._resting_since: float | None = None

    def remaining(self, distance: float) -> float:
        """The remaining distance for a distance to the goal."""
        if self._is_moving() or self._radius <= 0.0 or distance > self._radius + EARLY:
            self._resting_since = None
        elif self._resting_since is None:
            self._resting_since = self._now()
        has_stopped = self._resting_since is not None and self._now() - self._resting_since >= STOPPED
        return 0.0 if has_stopped else distance


class ReturnProgress:
    """Progress of a return that may climb first, as a number that decreases while it advances."""

    #: Metres that exceed noise: a hover never accumulates.
    STEP = 0.3

    def __init__(self) -> None:
        self._moved = 0.0
        self._last: Vector | None = None

    def remaining(self, place: Vector) -> float:
        """Minus the distance flown so far: a return has no known path, so any motion is progress."""
        step = 0.0 if self._last is None else math.dist(place, self._last)
        if self._last is None or step >= self.STEP:
            self._moved += step
            self._last = place
        return FAR - self._moved


#: Radians after which a vehicle is on its circle.
ONTO = 0.3


class Revolutions:
    """Counts the turns of an orbit; `remaining` returns the remaining distance in metres."""

    def __init__(self, circle: Circle, turns: float) -> None:
        self._circle, self._total = circle, turns * math.tau
        self._turned = 0.0
        self._last: float | None = None

    def remaining(self, place: Vector) -> float:
        """The remaining distance, including the approach to the circle."""
        north, east = place[0] - self._circle.centre[0], place[1] - self._circle.centre[1]
        deviation = abs(math.hypot(north, east) - self._circle.radius)
        angle = math.atan2(east, north)
        if deviation > 0.5 * self._circle.radius:
            self._last = None
            return deviation + self._total * self._circle.radius
        if self._last is not None:
            step = math.remainder(angle - self._last, math.tau)
            self._turned += step if self._circle.clockwise else -step
        self._last = angle
        # The vehicle may approach the circle until it is on it.
        approach = deviation if self._turned < min(ONTO, self._total) else 0.0
        return approach + (self._total - self._turned) * self._circle.radius


class Turning:
    """Whether a frame follows repeated yaw rates, by its heading.

    A car-like rover turns only while driving. The result is known after JUDGED seconds, when the frame should
    have turned by ENOUGH radians.
    """

    JUDGED, ENOUGH, SHARE = 2.0, 0.2, 0.25

    def __init__(self) -> None:
        self._since: float | None = None
        self._last_at = -math.inf
        self._rate = self._heading = 0.0

    def fails(self, rate: float, heading: float, gap: float, now: float) -> bool:
        """Adds a commanded rate; returns whether the same rate has had no effect.

        Restarts after a `gap` of so many seconds.
        """
        is_renewed = self._since is not None and rate == self._rate and now - self._last_at <= gap
        self._last_at = now
        if not is_renewed:
            self._since, self._rate, self._heading = now, rate, heading
        assert self._since is not None, "just set"
        expected = abs(rate) * (now - self._since)
        if now - self._since < self.JUDGED or expected < self.ENOUGH:
            return False
        actual = abs(math.remainder(heading - self._heading, math.tau))
        self._since = None
        return actual < self.SHARE * min(expected, math.pi)


class Following:
    """Whether a vehicle follows repeated velocities in m/s; the result is known after JUDGED seconds."""

    JUDGED, SHARE = 2.0, 1.0 / 3.0

    def __init__(self) -> None:
        self._since = self._last_at = -math.inf
        self._was_reported = False

    def fails(self, commanded: Vector, actual: Vector, gap: float, now: float) -> bool:
        """Adds a commanded velocity; returns, once, whether it had hardly any effect.

        Restarts after a `gap` of so many seconds.
        """
        speed = math.hypot(*commanded)
        along = sum(a * h for a, h in zip(commanded, actual, strict=True))
        is_renewed, self._last_at = now - self._last_at <= gap, now
        if not is_renewed or along >= self.SHARE * speed**2:
            self._since, self._was_reported = now, False
        if self._was_reported or now - self._since < self.JUDGED:
            return False
        self._was_reported = True
        return True
