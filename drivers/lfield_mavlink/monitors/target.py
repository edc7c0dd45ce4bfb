"""Whether the autopilot follows the targets that it was sent: what it tells of them is compared. Pure.

POSITION_TARGET_GLOBAL_INT and POSITION_TARGET_LOCAL_NED tell where an autopilot in the mode for setpoints is
going. Any station may send it somewhere else: an ArduCopter follows the last setpoint, whoever sent it, and
tells nobody (gauntlet-a). It tells no place while it follows a velocity, takes off, or holds after a takeoff;
PX4 tells a velocity without a place then (px4-copter.d-velocity). An ArduRover tells no velocity, but in
NAV_CONTROLLER_OUTPUT the distance to its place: 0 while it follows a velocity (ap-rover.f-fence-landing).
"""

from __future__ import annotations

import math
from collections import deque

from lfield_mavlink.geo import Vector

#: Metres over ground and in height between two targets that are not the same. What was sent is told again to
#: 0.011 m (ap-rover.c-speed: all of 174), the last digit of a latitude; the rest is for what was not
#: recorded, places of PX4 in OFFBOARD and of ArduCopter. Degrees and metres differ by FAR of the distance.
NEAR, LEVEL, FAR = 0.5, 1.0, 1e-3
#: The same for where a vehicle stops when it enters the mode: what is known of that is where it was.
RESTS, RESTS_LEVEL = 2.0, 3.0
#: m/s between two velocities that are not the same; over ground a slower one may be a bounded one.
SAME = 0.6
#: Metres about the vehicle within which a place may be where it stops by itself.
HERE = 5.0
#: Seconds for which a target may still be told that another has replaced: packets are late and lost.
LATE = 3.0
#: Metres before its goal, and its way to brake, within which a distance of 0 may be the rounded one.
ARRIVES = 3.0
#: Seconds in which the first of a series of targets must have been seen.
SEEN = 1.2


class TargetMonitor:
    """The targets of one vehicle in its local frame: those that were sent, and what it tells.

    A motion is by places, by velocities, or (a takeoff, a hover) by neither.
    """

    def __init__(self, *, level: bool = True) -> None:
        self._level = level
        self._places: deque[tuple[float, Vector]] = deque()
        self._velocities: deque[tuple[float, Vector]] = deque()
        # Targets of before and until when they may be told. Until one of these has been seen all of them may:
        # what its fence forbids it ignores.
        self._earlier: list[tuple[float, Vector]] = []
        self._began = math.inf
        # Where it stops when it has not taken in any place yet, and until when that may be told.
        self._rests: tuple[Vector, float] | None = None
        # When the newest of the places was sent that it is known to have followed.
        self._followed = -math.inf
        self._seen = self._by_velocity = False
        self._stops_at: float | None = None
        # Of the places of this motion the last one that it told, and when it told a distance of 0 before it.
        self._told: Vector | None = None
        self._nowhere_at = -math.inf
        self._strange: tuple[float, str] | None = None

    def clear(self, now: float) -> None:
        """What it follows from now on is no target that was sent; it may still tell the last ones."""
        self._earlier = [each for each in self._earlier if now <= each[0]]
        self._earlier += [(now + LATE, place) for _, place in self._places]
        self._places.clear()
        self._began, self._followed, self._seen, self._by_velocity = now, -math.inf, False, False
        self._strange = self._stops_at = self._told = None
        self._nowhere_at = -math.inf
        if self._rests is not None:
            self._rests = self._rests[0], min(self._rests[1], now + LATE)

    def on_place(self, place: Vector, now: float, rests_at: Vector | None) -> None:
        """A position was sent; `rests_at` is where it stops when it has not taken in any yet."""
        if self._by_velocity:
            self.clear(now)
        if not self._places:
            self._began = now
            if rests_at is not None:
                self._rests = rests_at, math.inf
        if self._places and self._places[-1][1] == place:
            self._places.pop()
        self._places.append((now, place))
        while len(self._places) > 1 and self._places[0][0] < min(now, self._followed) - LATE:
            self._places.popleft()

    def on_velocity(self, velocity: Vector, now: float) -> None:
        """A velocity was sent."""
        if not self._by_velocity:
            self.clear(now)
            self._by_velocity = True
        self._velocities.append((now, velocity))
        while self._velocities[0][0] < now - LATE:
            self._velocities.popleft()

    def on_told_place(self, place: Vector, now: float, here: Vector | None, *, aloft: bool) -> None:
        """The autopilot tells its target; a height that is not a number is not told.

        `here` is where it is, and `aloft` whether it flies: on the ground it may tell a target of long ago.
        """
        if (sent := self._sent_at(place, now)) is not None:
            self._followed = max(self._followed, sent)
            self._told = place if math.isfinite(sent) else self._told
            # Of a goal that is ignored it tells nothing: only the last one shows that they are followed.
            self._seen = self._seen or (bool(self._places) and self._is_near(place, self._places[-1][1]))
            return
        begins = now - self._began <= SEEN
        if self._places:
            if self._seen or not begins:
                self._find(now, f"{self._left(place):.0f} m from its goal")
        elif here is not None and (aloft or self._by_velocity):
            far = math.dist(place[:2], here[:2])
            if far > HERE or (self._by_velocity and not begins):
                self._find(now, f"to a place {far:.0f} m away")

    def on_told_distance(self, distance: float, here: Vector | None, speed: float, now: float) -> None:
        """A rover tells its distance to the place that it follows in metres, 0 while it follows none.

        A second 0 within LATE seconds is strange, far from the place of this motion that it told last.
        """
        told = self._told
        if distance > 0.0 or here is None or told is None:
            return
        left = math.dist(here[:2], told[:2])
        late = any(now <= until and self._is_near(told, place) for until, place in self._earlier)
        if late or left < ARRIVES + speed**2 / 2.0:
            return
        if now - self._nowhere_at <= LATE:
            self._find(now, f"to no place, {left:.0f} m before its goal")
        self._nowhere_at = now

    def on_told_velocity(self, velocity: Vector, now: float) -> None:
        """The autopilot tells that it follows a velocity."""
        words = f"at {math.hypot(*velocity):.1f} m/s"
        if self._was_sent(velocity, now):
            self._stops_at = None
        elif math.hypot(*velocity) > SAME:
            self._find(now, words)
        elif self._places and self._seen:
            # It stops instead of going on; once is what it does by itself when it enters the mode.
            self._stops_at = now if self._stops_at is None else self._stops_at
            if now - self._stops_at > SEEN:
                self._find(now, words)

    def on_guided(self, now: float) -> str:
        """It is still in the mode for setpoints: how its target differs from what was sent, in words.

        '' while it is the one that was sent, or nothing is known. A target of another mode may be told before
        that mode is.
        """
        return "" if self._strange is None or now <= self._strange[0] else self._strange[1]

    def _find(self, now: float, words: str) -> None:
        if self._strange is None:
            self._strange = now, words

    def _left(self, place: Vector) -> float:
        goal = self._places[-1][1]
        level = self._level and math.isfinite(place[2])
        return math.dist(place, goal) if level else math.dist(place[:2], goal[:2])

    def _sent_at(self, place: Vector, now: float) -> float | None:
        """When a place was sent last, minus infinity before this motion; None for one that was not."""
        for at, sent in reversed(self._places):
            if self._is_near(place, sent):
                return at
        if self._is_at_rest(place, now):
            return -math.inf
        ignored = bool(self._places) and not self._seen
        earlier = (each for until, each in self._earlier if now <= until or ignored)
        return -math.inf if any(self._is_near(place, sent) for sent in earlier) else None

    def _is_near(self, place: Vector, sent: Vector) -> bool:
        near = NEAR + FAR * math.hypot(*sent[:2])
        return math.dist(place[:2], sent[:2]) <= near and self._is_level(place, sent, LEVEL)

    def _is_at_rest(self, place: Vector, now: float) -> bool:
        if self._seen or self._rests is None or now > self._rests[1]:
            return False
        rests = self._rests[0]
        return math.dist(place[:2], rests[:2]) <= RESTS and self._is_level(place, rests, RESTS_LEVEL)

    def _is_level(self, place: Vector, sent: Vector, apart: float) -> bool:
        level = self._level and math.isfinite(place[2])
        return not level or abs(place[2] - sent[2]) <= apart

    def _was_sent(self, velocity: Vector, now: float) -> bool:
        """Whether it is a velocity of the last seconds, or the present one, bounded by the autopilot."""
        recent = [sent for at, sent in self._velocities if at >= now - LATE]
        recent += [self._velocities[-1][1]] if self._by_velocity else []
        return any(_is_bounded(velocity, sent) for sent in recent)


def _is_bounded(velocity: Vector, sent: Vector) -> bool:
    """Whether a velocity is another one, or a slower one in its direction; it may climb more slowly."""
    fast = math.hypot(*sent[:2])
    along = sum(v * s for v, s in zip(velocity[:2], sent[:2], strict=True)) / fast if fast else 0.0
    share = min(1.0, max(0.0, along / fast)) if fast else 0.0
    off = math.dist(velocity[:2], (share * sent[0], share * sent[1]))
    low, high = sorted((0.0, sent[2]))
    return off <= SAME and low - SAME <= velocity[2] <= high + SAME


class CourseMonitor:
    """Whether a vehicle that was on its way to a goal goes somewhere else, by its velocity over ground.

    It is on its way once its course is within TOWARDS of the goal; rovers turn first, and copters speed up.
    Then a course beyond OFF for LASTS seconds, faster than SPEED m/s, is not that to the goal. Within NEAR
    metres of it, and what it needs to brake, courses mean nothing.
    """

    TOWARDS, OFF, LASTS, SPEED, NEAR = math.radians(45.0), math.radians(60.0), 0.8, 0.8, 3.0

    def __init__(self) -> None:
        self._goal: Vector | None = None
        self._was_towards = False
        self._off_at = math.inf
        #: The m/s at which it goes elsewhere, 0 while it does not.
        self.leaves = 0.0

    def begin(self, goal: Vector | None) -> None:
        """A motion begins, to a goal or to none that is known."""
        self._goal, self._was_towards = goal, False
        self._off_at, self.leaves = math.inf, 0.0

    def on_motion(self, place: Vector, velocity: Vector, now: float) -> None:
        """A sample."""
        if self._goal is None:
            return
        way = (self._goal[0] - place[0], self._goal[1] - place[1])
        left, speed = math.hypot(*way), math.hypot(*velocity[:2])
        if speed < self.SPEED or left < self.NEAR + speed**2 / 2.0:
            self._off_at, self.leaves = math.inf, 0.0
            return
        cosine = (way[0] * velocity[0] + way[1] * velocity[1]) / (left * speed)
        off = math.acos(min(1.0, max(-1.0, cosine)))
        self._was_towards = self._was_towards or off < self.TOWARDS
        if not self._was_towards or off < self.OFF:
            self._off_at, self.leaves = math.inf, 0.0
            return
        self._off_at = min(self._off_at, now)
        if now - self._off_at >= self.LASTS:
            self.leaves = speed
