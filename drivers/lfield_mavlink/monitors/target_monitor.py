"""Compares the target that the autopilot reports with the targets that were sent. Pure.

POSITION_TARGET_GLOBAL_INT and POSITION_TARGET_LOCAL_NED report the target in the mode for setpoints. Any
station may send another target: an ArduCopter follows the last setpoint of any sender without a notice
(gauntlet-a). It reports no position while it follows a velocity, takes off, or holds after a takeoff; PX4
then reports a velocity without a position (px4-copter.d-velocity). An ArduRover reports no velocity, but the
distance to its target in NAV_CONTROLLER_OUTPUT: 0 while it follows a velocity (ap-rover.f-fence-landing).
"""

from __future__ import annotations

import math
from collections import deque

from lfield_mavlink.geodesy import Vector

#: Metres over ground and in height between two different targets. Autopilots report a sent target to within
#: 0.011 m (ap-rover.c-speed: all of 174), the last digit of a latitude; the rest is a margin for cases
#: without recordings, PX4 in OFFBOARD and ArduCopter. Degrees and metres differ by FAR of the distance.
NEAR, LEVEL, FAR = 0.5, 1.0, 1e-3
#: The same for the stopping position when a vehicle enters the mode, which is only known approximately.
RESTS, RESTS_LEVEL = 2.0, 3.0
#: m/s between two different velocities; a slower horizontal one may be a limited one.
SAME = 0.6
#: Metres around the vehicle within which a target may be its own stopping position.
HERE = 5.0
#: Seconds for which a replaced target may still be reported: packets are late and lost.
LATE = 3.0
#: Metres before its goal and braking distance, within which a distance of 0 may be rounded.
ARRIVES = 3.0
#: Seconds in which the first of a series of targets must be reported.
FIRST_TARGET_TIMEOUT = 1.2


class TargetMonitor:
    """The targets of one vehicle in its local frame: sent and reported.

    A motion is by positions, by velocities, or (a takeoff, a hover) by neither.
    """

    def __init__(self, *, level: bool = True) -> None:
        self._level = level
        self._places: deque[tuple[float, Vector]] = deque()
        self._velocities: deque[tuple[float, Vector]] = deque()
        # Earlier targets, each with the time until which it may be reported. Until a new target is reported,
        # all of them may be, since the autopilot ignores targets outside its fence.
        self._earlier: list[tuple[float, Vector]] = []
        self._started_at = math.inf
        # The stopping place of a vehicle that has accepted no position yet, and the end of reports of it.
        self._stop_place: tuple[Vector, float] | None = None
        # The time of the newest sent position that the vehicle is known to have followed.
        self._followed = -math.inf
        self._is_confirmed = self._by_velocity = False
        self._stops_at: float | None = None
        # The last reported position of this motion, and when a distance of 0 was reported before reaching it.
        self._reported: Vector | None = None
        self._undefined_at = -math.inf
        self._foreign: tuple[float, str] | None = None

    def clear(self, now: float) -> None:
        """Ends the sent targets: the vehicle follows none from now on, but may still report the last ones."""
        self._earlier = [each for each in self._earlier if now <= each[0]]
        self._earlier += [(now + LATE, place) for _, place in self._places]
        self._places.clear()
        self._started_at, self._followed, self._is_confirmed, self._by_velocity = now, -math.inf, False, False
        self._foreign = self._stops_at = self._reported = None
        self._undefined_at = -math.inf
        if self._stop_place is not None:
            self._stop_place = self._stop_place[0], min(self._stop_place[1], now + LATE)

    def on_place(self, place: Vector, now: float, rests_at: Vector | None) -> None:
        """Records a sent position; `rests_at` is the stopping place of a vehicle that has not accepted one
        yet.
        """
        if self._by_velocity:
            self.clear(now)
        if not self._places:
            self._started_at = now
            if rests_at is not None:
                self._stop_place = rests_at, math.inf
        if self._places and self._places[-1][1] == place:
            self._places.pop()
        self._places.append((now, place))
        while len(self._places) > 1 and self._places[0][0] < min(now, self._followed) - LATE:
            self._places.popleft()

    def on_velocity(self, velocity: Vector, now: float) -> None:
        """Records a sent velocity."""
        if not self._by_velocity:
            self.clear(now)
            self._by_velocity = True
        self._velocities.append((now, velocity))
        while self._velocities[0][0] < now - LATE:
            self._velocities.popleft()

    def on_reported_place(self, place: Vector, now: float, position: Vector | None, *, aloft: bool) -> None:
        """Handles a target that the autopilot reports; a height of NaN is not reported.

        `position` is the vehicle's, `aloft` whether it flies: on the ground it may report an old target.
        """
        if (sent_at := self._time_of(place, now)) is not None:
            self._followed = max(self._followed, sent_at)
            self._reported = place if math.isfinite(sent_at) else self._reported
            # The autopilot does not report an ignored goal: only the last goal shows that goals are followed.
            self._is_confirmed = self._is_confirmed or (
                bool(self._places) and self._is_near(place, self._places[-1][1])
            )
            return
        is_initial = now - self._started_at <= FIRST_TARGET_TIMEOUT
        if self._places:
            if self._is_confirmed or not is_initial:
                self._report(now, f"{self._distance(place):.0f} m from its goal")
        elif position is not None and (aloft or self._by_velocity):
            distance = math.dist(place[:2], position[:2])
            if distance > HERE or (self._by_velocity and not is_initial):
                self._report(now, f"to a place {distance:.0f} m away")

    def on_reported_distance(
        self, distance: float, position: Vector | None, speed: float, now: float
    ) -> None:
        """Handles the distance in metres to its target that a rover reports, 0 without one.

        A second 0 within LATE seconds is foreign if it is far from the last reported position of this motion.
        """
        reported = self._reported
        if distance > 0.0 or position is None or reported is None:
            return
        remaining = math.dist(position[:2], reported[:2])
        is_late = any(now <= until and self._is_near(reported, place) for until, place in self._earlier)
        if is_late or remaining < ARRIVES + speed**2 / 2.0:
            return
        if now - self._undefined_at <= LATE:
            self._report(now, f"to no place, {remaining:.0f} m before its goal")
        self._undefined_at = now

    def on_reported_velocity(self, velocity: Vector, now: float) -> None:
        """Handles a report of the autopilot that it follows a velocity."""
        description = f"at {math.hypot(*velocity):.1f} m/s"
        if self._was_sent(velocity, now):
            self._stops_at = None
        elif math.hypot(*velocity) > SAME:
            self._report(now, description)
        elif self._places and self._is_confirmed:
            # The vehicle stops instead of continuing; once is its own behaviour when it enters the mode.
            self._stops_at = now if self._stops_at is None else self._stops_at
            if now - self._stops_at > FIRST_TARGET_TIMEOUT:
                self._report(now, description)

    def on_guided(self, now: float) -> str:
        """The difference in words of the reported target from the sent one, in the mode for setpoints.

        '' while both are equal, or no target is known. A target may be reported before the mode that
        belongs to it.
        """
        return "" if self._foreign is None or now <= self._foreign[0] else self._foreign[1]

    def _report(self, now: float, reason: str) -> None:
        if self._foreign is None:
            self._foreign = now, reason

    def _distance(self, place: Vector) -> float:
        goal = self._places[-1][1]
        level = self._level and math.isfinite(place[2])
        return math.dist(place, goal) if level else math.dist(place[:2], goal[:2])

    def _time_of(self, place: Vector, now: float) -> float | None:
        """The time when a position was last sent, minus infinity before this motion; None if it was not
        sent.
        """
        for at, sent in reversed(self._places):
            if self._is_near(place, sent):
                return at
        if self._is_at_rest(place, now):
            return -math.inf
        ignored = bool(self._places) and not self._is_confirmed
        earlier = (each for until, each in self._earlier if now <= until or ignored)
        return -math.inf if any(self._is_near(place, sent) for sent in earlier) else None

    def _is_near(self, place: Vector, sent: Vector) -> bool:
        tolerance = NEAR + FAR * math.hypot(*sent[:2])
        return math.dist(place[:2], sent[:2]) <= tolerance and self._is_level(place, sent, LEVEL)

    def _is_at_rest(self, place: Vector, now: float) -> bool:
        if self._is_confirmed or self._stop_place is None or now > self._stop_place[1]:
            return False
        stop_place = self._stop_place[0]
        return math.dist(place[:2], stop_place[:2]) <= RESTS and self._is_level(
            place, stop_place, RESTS_LEVEL
        )

    def _is_level(self, place: Vector, sent: Vector, tolerance: float) -> bool:
        level = self._level and math.isfinite(place[2])
        return not level or abs(place[2] - sent[2]) <= tolerance

    def _was_sent(self, velocity: Vector, now: float) -> bool:
        """Whether a velocity is one of the last seconds, or the present one, limited by the autopilot."""
        recent = [sent for at, sent in self._velocities if at >= now - LATE]
        recent += [self._velocities[-1][1]] if self._by_velocity else []
        return any(_is_bounded(velocity, sent) for sent in recent)


def _is_bounded(velocity: Vector, sent: Vector) -> bool:
    """Whether a velocity is another one, or a slower one in its direction; it may climb more slowly."""
    sent_speed = math.hypot(*sent[:2])
    along = (
        sum(v * s for v, s in zip(velocity[:2], sent[:2], strict=True)) / sent_speed if sent_speed else 0.0
    )
    share = min(1.0, max(0.0, along / sent_speed)) if sent_speed else 0.0
    deviation = math.dist(velocity[:2], (share * sent[0], share * sent[1]))
    low, high = sorted((0.0, sent[2]))
    return deviation <= SAME and low - SAME <= velocity[2] <= high + SAME


class CourseMonitor:
    """Detects that a vehicle on its way to a goal moves elsewhere, by its horizontal velocity.

    A vehicle is on its way once its course is within TOWARDS of the goal; rovers turn first, and copters
    accelerate. Then a course that is off by more than OFF for LASTS seconds, faster than SPEED m/s, is
    foreign. Within NEAR metres plus the braking distance courses are ignored.
    """

    TOWARDS, OFF, LASTS, SPEED, NEAR = math.radians(45.0), math.radians(60.0), 0.8, 0.8, 3.0

    def __init__(self) -> None:
        self._goal: Vector | None = None
        self._was_towards = False
        self._off_at = math.inf
        #: The speed in m/s at which the vehicle moves elsewhere, 0 while it does not.
        self.leaves = 0.0

    def start(self, goal: Vector | None) -> None:
        """Starts to monitor a motion, to a goal or without a known one."""
        self._goal, self._was_towards = goal, False
        self._off_at, self.leaves = math.inf, 0.0

    def on_motion(self, place: Vector, velocity: Vector, now: float) -> None:
        """Handles a sample of the motion."""
        if self._goal is None:
            return
        offset = (self._goal[0] - place[0], self._goal[1] - place[1])
        distance, speed = math.hypot(*offset), math.hypot(*velocity[:2])
        if speed < self.SPEED or distance < self.NEAR + speed**2 / 2.0:
            self._off_at, self.leaves = math.inf, 0.0
            return
        cosine = (offset[0] * velocity[0] + offset[1] * velocity[1]) / (distance * speed)
        deviation = math.acos(min(1.0, max(-1.0, cosine)))
        self._was_towards = self._was_towards or deviation < self.TOWARDS
        if not self._was_towards or deviation < self.OFF:
            self._off_at, self.leaves = math.inf, 0.0
            return
        self._off_at = min(self._off_at, now)
        if now - self._off_at >= self.LASTS:
            self.leaves = speed
