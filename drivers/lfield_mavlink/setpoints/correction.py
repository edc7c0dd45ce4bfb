"""What a vehicle must be commanded so that it obeys a speed over ground. Pure.

ArduRover settles at its speed, but shoots over it by 10 to 15 % when it speeds up to it (2.20 of 2 and 3.44
of 3, recorded); PX4's rover drives half a metre per second faster than it is commanded; ArduCopter in wind of
9 m/s flies 5 % faster. So a speed is approached from below, and what is flown in steady motion corrects it.
"""

from __future__ import annotations

import math

#: Seconds over which what is flown is averaged.
WINDOW = 1.0
#: What two averages may differ by in steady motion, as a share of the speed.
STEADY = 0.05
#: Shares of the speed by which it may be exceeded, or not be reached, before it is corrected.
ABOVE, BELOW = 0.01, 0.03
#: The shares from which it is no inaccuracy but another speed, which the limits of the binding see to, or a
#: vehicle that is held up.
OTHER, HELD_UP = 0.2, 0.5
#: The share of a difference that one correction makes good.
GAIN = 0.8
#: The least share of a speed that is commanded.
LEAST = 0.3


class SpeedCorrection:
    """The share of a speed over ground that is commanded, from `share` on; never more than all of it."""

    def __init__(self, share: float = 1.0) -> None:
        self.share = self._first = share
        self._began: float | None = None
        self._sum, self._count = 0.0, 0
        self._before: float | None = None

    def commanded(self, speed: float) -> float:
        """What is commanded for a speed in m/s."""
        return speed * self.share

    def reset(self) -> None:
        """It begins anew: the vehicle stands, or is commanded another speed."""
        self.share = self._first
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

    def _correct(self, mean: float, before: float | None, speed: float) -> bool:
        off = (speed - mean) / speed
        if off < -OTHER or off > HELD_UP:
            return False
        is_steady = before is not None and abs(mean - before) <= STEADY * speed
        if not (off < -ABOVE or (off > BELOW and is_steady)):
            return False
        share = min(1.0, max(LEAST, self.share * (1.0 + GAIN * off)))
        changed = not math.isclose(share, self.share, rel_tol=1e-3)
        self.share = share
        return changed
