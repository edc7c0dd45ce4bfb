"""Velocity profiles to a goal (rectangular, triangular or trapezoidal), in closed form.

https://emanual.robotis.com/docs/en/dxl/x/xm430-w350/#what-is-the-profile. Any units of length and time.
"""

from __future__ import annotations

import math

from msgspec import Struct

#: Bits 4 and 5 of Moving Status.
STEP, RECTANGULAR, TRIANGULAR, TRAPEZOIDAL = 0x00, 0x10, 0x20, 0x30


class _Leg(Struct, frozen=True):
    """A segment of constant acceleration from a position and speed."""

    duration: float
    place: float
    speed: float
    acceleration: float

    def at(self, time: float) -> tuple[float, float]:
        """Position and speed after some time."""
        change = self.acceleration * time
        return self.place + (self.speed + change / 2.0) * time, self.speed + change


class MotionProfile:
    """The motion from a position and speed to rest at a goal. `kind` is the profile type of Moving Status.

    `fastest` and `acceleration` may be infinite: an infinite speed reaches the goal at once. A start above
    `fastest`, or that cannot stop before the goal, slows down first.
    """

    def __init__(self, place: float, speed: float, goal: float, fastest: float, acceleration: float) -> None:
        self.goal, self.kind = goal, STEP
        self._legs: list[_Leg] = []
        if math.isfinite(fastest):
            if math.isfinite(acceleration):
                self._accelerated(place, speed, fastest, acceleration)
            else:
                self.kind = RECTANGULAR
                self._leg(place, math.copysign(fastest, goal - place), abs(goal - place) / fastest, 0.0)
        self.duration = sum(leg.duration for leg in self._legs)

    def _accelerated(self, place: float, speed: float, fastest: float, acceleration: float) -> None:
        stop_position = place + speed * abs(speed) / (2.0 * acceleration)
        direction = math.copysign(1.0, self.goal - stop_position)
        distance, speed = direction * (self.goal - place), direction * speed
        peak = math.sqrt(max(0.0, acceleration * distance + speed * speed / 2.0))
        self.kind = TRAPEZOIDAL if peak > fastest else TRIANGULAR
        peak = max(min(peak, fastest), min(speed, fastest))
        change = math.copysign(acceleration, peak - speed)
        speed_change_distance = (peak * peak - speed * speed) / (2.0 * change)
        cruise = distance - speed_change_distance - peak * peak / (2.0 * acceleration)
        place = self._leg(place, direction * speed, abs(peak - speed) / acceleration, direction * change)
        if peak > 0.0:
            place = self._leg(place, direction * peak, max(0.0, cruise) / peak, 0.0)
        self._leg(place, direction * peak, peak / acceleration, -direction * acceleration)

    def _leg(self, place: float, speed: float, duration: float, acceleration: float) -> float:
        leg = _Leg(duration, place, speed, acceleration)
        self._legs.append(leg)
        return leg.at(duration)[0]

    def at(self, time: float) -> tuple[float, float]:
        """Position and speed, `time` after the start."""
        for leg in self._legs:
            if time < leg.duration:
                return leg.at(time)
            time -= leg.duration
        return self.goal, 0.0


def timed(distance: float, total: float, rising: float) -> tuple[float, float]:
    """Speed and acceleration of a motion of duration `total` from rest to rest, with acceleration time
    `rising`.

    `rising` is at most half of `total`, as in the manual for Profile Acceleration.
    """
    rising = min(rising, total / 2.0)
    fastest = abs(distance) / (total - rising)
    return fastest, fastest / rising if rising > 0.0 else math.inf
