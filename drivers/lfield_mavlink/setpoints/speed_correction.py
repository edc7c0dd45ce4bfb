"""Feedback correction of a commanded horizontal speed. Pure.

ArduRover reaches its speed with an overshoot of 10 to 15 % (2.20 of 2 and 3.44 of 3, recorded); PX4's rover
drives 0.45 m/s faster than commanded (1.48 for 1.0, recorded); ArduCopter in wind of 9 m/s flies 5 % faster.
So a speed is approached from below, and corrected by the actual speed in steady motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield_mavlink.modes import Profile

#: Averaging window in seconds.
WINDOW = 1.0
#: Relative difference of two averages in steady motion.
STEADY = 0.05
#: Relative excess and shortfall before a correction.
ABOVE, BELOW = 0.01, 0.03
#: Relative deviations of another speed, which the limits handle, and of a vehicle that is blocked.
OTHER, HELD_UP = 0.2, 0.8
#: The share of a difference that one correction removes.
GAIN = 0.8
#: The least share of the initial command that a correction leaves.
LEAST = 0.3
#: The share of a vehicle's speed along its path when it drives straight.
STRAIGHT = 0.95
#: The initial share for ArduRover; excess of PX4's rover in m/s, and its remaining share of a low speed.
ROVER_FIRST, PX4_ROVER_EXCESS, PX4_ROVER_FIRST = 0.85, 0.45, 0.15
#: The share for autonomous motions of ArduRover, without correction: with its overshoot it reaches the speed.
ROVER_BY_ITSELF = 0.88


class SpeedCorrection:
    """The commanded part of a horizontal speed; never more than all of it.

    Initially the share `first`, less `excess` m/s by which the vehicle is known to be faster; `share` is the
    corrected value.
    """

    def __init__(self, first: float = 1.0, excess: float = 0.0) -> None:
        self.share = 1.0
        self._first, self._excess = first, excess
        self._started_at: float | None = None
        self._sum, self._count = 0.0, 0
        self._previous_mean: float | None = None

    @classmethod
    def for_profile(cls, profile: Profile) -> SpeedCorrection:
        """The correction for a kind of vehicle under its autopilot."""
        if profile.kind != "rover":
            return cls()
        return cls(excess=PX4_ROVER_EXCESS) if profile.px4 else cls(ROVER_FIRST)

    def commanded(self, speed: float) -> float:
        """The commanded speed for a target in m/s."""
        return speed * min(1.0, self._at_first(speed) * self.share)

    def _at_first(self, speed: float) -> float:
        return max(self._first - self._excess / speed, PX4_ROVER_FIRST) if speed > 0.0 else self._first

    def reset(self) -> None:
        """Restarts the correction: the vehicle stopped, or has another target."""
        self.share = 1.0
        self.pause()

    def pause(self) -> None:
        """Discards the present average: the vehicle turned, or braked."""
        self._started_at = self._previous_mean = None
        self._sum, self._count = 0.0, 0

    def sample(self, actual: float, speed: float, now: float) -> bool:
        """Adds an actual speed for a target speed; returns whether the share has changed."""
        if self._started_at is None:
            self._started_at = now
        self._sum += actual
        self._count += 1
        if now - self._started_at < WINDOW:
            return False
        mean, previous = self._sum / self._count, self._previous_mean
        self._started_at, self._sum, self._count, self._previous_mean = now, 0.0, 0, mean
        return self._correct(mean, previous, speed)

    def follow(self, velocity: Sequence[float], direction: Sequence[float], speed: float, now: float) -> None:
        """Samples the actual speed in a `direction` (north, east); turns are ignored."""
        actual = math.hypot(*velocity[:2])
        along = velocity[0] * direction[0] + velocity[1] * direction[1]
        if along > STRAIGHT * actual * math.hypot(*direction):
            self.sample(actual, speed, now)
        else:
            self.pause()

    def _correct(self, mean: float, previous: float | None, speed: float) -> bool:
        deviation = (speed - mean) / speed
        is_steady = previous is not None and abs(mean - previous) <= STEADY * speed
        # A vehicle that gets its speed with each setpoint does not forget it: it is still decelerating.
        is_other = deviation < -OTHER and not (self._excess and is_steady)
        if is_other or deviation > HELD_UP:
            return False
        if not (deviation < -ABOVE or (deviation > BELOW and is_steady)):
            return False
        share = min(1.0 / self._at_first(speed), max(LEAST, self.share * (1.0 + GAIN * deviation)))
        has_changed = not math.isclose(share, self.share, rel_tol=1e-3)
        self.share = share
        return has_changed
