"""The limits of the binding, before and after: what is refused, and what telemetry says of the flight. Pure.

A goal or a speed beyond a limit is refused before anything is sent. What is then flown is watched: an
autopilot may keep its own speed, and a return its own height.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from lfield.driver import DeviceBinding, DeviceError
from lfield_mavlink.geo import Vector

#: m/s by which an excess must have become less to be seen to do so; what is less may be noise.
LESS = 0.1
#: How many times its `time` a correction that helps may take until the value is within its limit.
LONGEST = 5
#: By what a value at its limit may exceed it once it was on the wire: heights in metres and speeds as a share
#: (floats of 32 bits), places in metres (1e-7 degrees).
ROUNDED_HEIGHT, ROUNDED_SPEED, ROUNDED_PLACE = 1e-3, 1e-6, 0.02
#: m/s2 with which everything can brake.
BRAKES = 2.0


class Verdict(Enum):
    """What becomes of a value: it must be corrected, cannot be, or is within its limit again."""

    CORRECT = auto()
    HELPLESS = auto()
    WITHIN = auto()


@dataclass(slots=True)
class LimitWatch:
    """Samples of one value against its limit, with room for gusts and noise.

    `bound` is the limit with its tolerance. A value that is beyond it for `time` seconds without a break must
    be corrected. Once the correction is `told`, for which there is as much time again, the excess must become
    less: when it has not done so for `time` seconds, or is not gone after LONGEST times that, the correction
    does not help. An excess of at most `still` is as good as none. The excess of a speed is what is above the
    bound, that of a place the speed at which it leads farther out; both in m/s. What was not heard for `time`
    is not known to have been beyond anything.
    """

    bound: float
    time: float
    still: float = 0.0
    _beyond_since: float | None = None
    _heard_at: float = -math.inf
    _correction: _Correction | None = None

    def sample(self, value: float, excess: float, now: float) -> Verdict | None:
        """Take one sample in; what is to be done about it, if that is news."""
        gap, self._heard_at = now - self._heard_at, now
        if value <= self.bound:
            return self._within()
        if self._correction is not None:
            return self._look(self._correction, excess, now)
        if self._beyond_since is None or gap > self.time:
            self._beyond_since = now
        if now - self._beyond_since < self.time:
            return None
        self._correction = _Correction(now, now + self.time, excess)
        return Verdict.CORRECT

    def told(self, now: float) -> None:
        """The correction has been taken, or nothing more is on its way: from here on it must show."""
        if self._correction is not None:
            self._correction.less_at = min(self._correction.less_at, now)

    def reset(self) -> None:
        """Nothing is known any more, since its motors are off."""
        self._beyond_since = self._correction = None

    def _within(self) -> Verdict | None:
        corrected = self._correction is not None
        self.reset()
        return Verdict.WITHIN if corrected else None

    def _look(self, correction: _Correction, excess: float, now: float) -> Verdict | None:
        if excess <= self.still:
            self._correction = _Correction(now, now, excess)
            return None
        correction.sample(excess, now)
        in_vain = now - correction.less_at >= self.time or now - correction.began >= LONGEST * self.time
        if not in_vain:
            return None
        self._correction = _Correction(now, now, excess)
        return Verdict.HELPLESS


class _Correction:
    """How an excess goes on after a correction: down, at first perhaps from more than it was.

    `less_at` is when it was seen to become less, at first when it may have begun to.
    """

    def __init__(self, now: float, less_at: float, excess: float) -> None:
        self.began, self.less_at = now, less_at
        self._least, self._turned = excess, False

    def sample(self, excess: float, now: float) -> None:
        """Note when it has become less than ever before."""
        if excess <= self._least - LESS:
            self._least, self._turned, self.less_at = excess, True, now
        elif not self._turned:
            self._least = max(self._least, excess)


class Limits:
    """What a binding allows, about home: `altitude` and `radius` in metres, `speed` in m/s.

    `error` makes the exception for a reason.
    """

    def __init__(self, binding: DeviceBinding, error: Callable[[str], DeviceError]) -> None:
        self._ttl, self._error = binding.ttl, error
        self._altitude = binding.limits.get("altitude", math.inf)
        self._radius = binding.limits.get("radius", math.inf)
        self._speed = binding.limits.get("speed", math.inf)

    @property
    def bound_places(self) -> bool:
        """Whether there is anywhere that the vehicle may not go."""
        return min(self._altitude, self._radius) < math.inf

    @property
    def places(self) -> tuple[float, float]:
        """The greatest distance from home and the greatest height about it, in metres; inf for none."""
        return self._radius, self._altitude

    @property
    def bounds_anything(self) -> bool:
        """Whether the binding has any limit."""
        return min(self._altitude, self._radius, self._speed) < math.inf

    @property
    def bounds_radius(self) -> bool:
        """Whether there is a distance from home that it may not exceed."""
        return self._radius < math.inf

    @property
    def bounds_speed(self) -> bool:
        """Whether there is a speed over ground that it may not exceed."""
        return self._speed < math.inf

    def check_goal(self, what: str, goal: Vector, extent: float = 0.0) -> None:
        """Refuse a goal that is no place, or beyond the limits. Raises DeviceError.

        `extent` is how many metres around the goal are flown, as by a circle.
        """
        north, east, down = goal
        if not all(map(math.isfinite, goal)):
            raise self._error(f"{what} needs finite numbers")
        if -down > self._altitude + ROUNDED_HEIGHT:
            raise self._error(f"{what} refused: {-down:g} m is above the limit of {self._altitude:g} m")
        far = math.hypot(north, east) + extent
        if far > self._radius + ROUNDED_PLACE:
            raise self._error(
                f"{what} refused: {far:.1f} m from home is beyond the limit of {self._radius:g} m"
            )

    def check_return(self, what: str, height: float, parameter: str) -> None:
        """Refuse a return that climbs above the limit, as a parameter has it. Raises DeviceError."""
        if height > self._altitude + ROUNDED_HEIGHT:
            raise self._error(
                f"{what} refused: it would climb to {height:g} m ({parameter}), above the limit of "
                f"{self._altitude:g} m; set {parameter} lower, or go home by goTo and land"
            )

    @property
    def bounds_heights(self) -> bool:
        """Whether there is a height that it may not go above."""
        return self._altitude < math.inf

    def check_speed(self, what: str, speed: float) -> None:
        """Refuse a speed over ground above the limit. Raises DeviceError."""
        if not (math.isfinite(speed) and speed <= self._speed * (1.0 + ROUNDED_SPEED)):
            raise self._error(f"{what} of {speed:g} m/s is above the limit of {self._speed:g} m/s")

    def check_way_out(self, place: Vector | None, velocity: Vector) -> None:
        """Refuse a velocity that leads out of the limits before its time-to-live is over, or farther out.

        Then it must brake, which takes a way, too. Without a place nothing is known of that. Raises
        DeviceError.
        """
        if place is None:
            return
        lasts = self._ttl + math.hypot(*velocity) / (2.0 * BRAKES)
        ahead = tuple(p + v * lasts for p, v in zip(place, velocity, strict=True))
        if math.hypot(*ahead[:2]) > max(self._radius, math.hypot(*place[:2])):
            raise self._error(f"setVelocity refused: it leads beyond the limit of {self._radius:g} m")
        if -ahead[2] > max(self._altitude, -place[2]):
            raise self._error(f"setVelocity refused: it leads above the limit of {self._altitude:g} m")
