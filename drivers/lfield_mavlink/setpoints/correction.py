"""What a vehicle must be commanded so that it obeys a speed over ground. Pure.

ArduRover settles at its speed, but shoots over it by 10 to 15 % when it speeds up to it (2.20 of 2 and 3.44
of 3, recorded); PX4's rover drives 0.45 m/s faster than it is commanded (1.48 for 1.0, recorded); ArduCopter
in wind of 9 m/s flies 5 % faster. So a speed is approached from below, and what is flown in steady motion
corrects it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield_mavlink.modes import Profile

#: Seconds over which what is flown is averaged.
WINDOW = 1.0
#: What two averages may differ by in steady motion, as a share of the speed.
STEADY = 0.05
#: Shares of the speed by which it may be exceeded, or not be reached, before it is corrected.
ABOVE, BELOW = 0.01, 0.03
#: The shares from which it is no inaccuracy but another speed, which the limits of the binding see to, or a
#: vehicle that is held up.
OTHER, HELD_UP = 0.2, 0.8
#: The share of a difference that one correction makes good.
GAIN = 0.8
#: The least share of what is commanded at first that a correction leaves.
LEAST = 0.3
#: The share of its speed that goes along its way when it drives straight.
STRAIGHT = 0.95
#: The share of a speed that ArduRover is commanded at first; m/s by which PX4's rover drives faster than
#: commanded, and the share that is left of a low speed.
ROVER_FIRST, PX4_ROVER_EXCESS, PX4_ROVER_FIRST = 0.85, 0.45, 0.15
#: The share that ArduRover is commanded for what it drives by itself, where nothing corrects it: with its
#: overshoot of 10 to 15 % it comes up to the speed.
ROVER_BY_ITSELF = 0.88


class SpeedCorrection:
    """What is commanded of a speed over ground; never more than all of it.

    At first that is the share `first`, less `excess` m/s by which the vehicle is known to be faster; `share`
    is what has become of that by what is flown.
    """

    def __init__(self, first: float = 1.0, excess: float = 0.0) -> None:
        self.share = 1.0
        self._first, self._excess = first, excess
        self._began: float | None = None
        self._sum, self._count = 0.0, 0
        self._before: float | None = None

    @classmethod
    def of(cls, profile: Profile) -> SpeedCorrection:
        """That of a kind of vehicle under its autopilot."""
        if profile.kind != "rover":
            return cls()
        return cls(excess=PX4_ROVER_EXCESS) if profile.px4 else cls(ROVER_FIRST)

    def commanded(self, speed: float) -> float:
        """What is commanded for a speed in m/s."""
        return speed * min(1.0, self._at_first(speed) * self.share)

    def _at_first(self, speed: float) -> float:
        return max(self._first - self._excess / speed, PX4_ROVER_FIRST) if speed > 0.0 else self._first

    def reset(self) -> None:
        """It begins anew: the vehicle stands, or is commanded another speed."""
        self.share = 1.0
        self.pause()

    def pause(self) -> None:
        """What was flown until now says nothing of the speed: it turned, or braked."""
        self._began = self._before = None
        self._sum, self._count = 0.0, 0

    def sample(self, flown: float, speed: float, now: float) -> bool:
        """Take in a speed over ground that was flown, of one that is to be; whether the share has changed."""
        if self._began is None:
            self._began = now
        self._sum += flown
        self._count += 1
        if now - self._began < WINDOW:
            return False
        mean, before = self._sum / self._count, self._before
        self._began, self._sum, self._count, self._before = now, 0.0, 0, mean
        return self._correct(mean, before, speed)

    def follow(self, velocity: Sequence[float], way: Sequence[float], speed: float, now: float) -> None:
        """Sample what is driven straight along `way` (north, east); a turn says nothing of the speed."""
        driven = math.hypot(*velocity[:2])
        if velocity[0] * way[0] + velocity[1] * way[1] > STRAIGHT * driven * math.hypot(*way):
            self.sample(driven, speed, now)
        else:
            self.pause()

    def _correct(self, mean: float, before: float | None, speed: float) -> bool:
        off = (speed - mean) / speed
        is_steady = before is not None and abs(mean - before) <= STEADY * speed
        # What is told its speed with each setpoint does not forget it: it only slows down yet.
        is_other = off < -OTHER and not (self._excess and is_steady)
        if is_other or off > HELD_UP:
            return False
        if not (off < -ABOVE or (off > BELOW and is_steady)):
            return False
        share = min(1.0 / self._at_first(speed), max(LEAST, self.share * (1.0 + GAIN * off)))
        changed = not math.isclose(share, self.share, rel_tol=1e-3)
        self.share = share
        return changed
