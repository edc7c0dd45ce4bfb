"""Limits of the binding: refuses commands that exceed them, and evaluates telemetry. Pure.

A goal or speed beyond a limit is refused before a command is sent. The flight is watched as well: an
autopilot may use its own speed, and its own height for a return.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum, auto

from msgspec import Struct

from lfield.driver import DeviceBinding, DeviceError
from lfield_mavlink.geodesy import Vector

#: m/s by which an excess must decrease to count; less may be noise.
LESS = 0.1
#: A correction that helps may take this many times its `time`.
LONGEST = 5
#: Rounding of values on the wire: heights in metres and speeds as a share (32-bit floats), positions in
#: metres (1e-7 degrees).
ROUNDED_HEIGHT, ROUNDED_SPEED, ROUNDED_PLACE = 1e-3, 1e-6, 0.02
#: Deceleration that every vehicle can reach, m/s2.
BRAKES = 2.0


class Verdict(Enum):
    """The result for a value: correction required, correction failed, or within its limit again."""

    CORRECT = auto()
    FAILED = auto()
    WITHIN = auto()


class LimitWatch(Struct):
    """Compares samples of one value with its limit, tolerating gusts and noise.

    `bound` is the limit with its tolerance. A value that exceeds it for `time` seconds without interruption
    must be corrected. After `on_correction_sent` and another `time`, the excess must decrease: if it has not
    for `time` seconds, or is not gone after LONGEST times that, the correction has failed. An excess of at
    most `still` is ignored. The excess of a speed is the part above the bound, that of a position its outward
    speed; both in m/s. A gap in telemetry of `time` resets it.
    """

    bound: float
    time: float
    still: float = 0.0
    _beyond_since: float | None = None
    _last_sample: float = -math.inf
    _correction: _Correction | None = None

    def sample(self, value: float, excess: float, now: float) -> Verdict | None:
        """Adds a sample; returns a new result, if any."""
        gap, self._last_sample = now - self._last_sample, now
        if value <= self.bound:
            return self._within()
        if self._correction is not None:
            return self._check_correction(self._correction, excess, now)
        if self._beyond_since is None or gap > self.time:
            self._beyond_since = now
        if now - self._beyond_since < self.time:
            return None
        self._correction = _Correction(now, now + self.time, excess)
        return Verdict.CORRECT

    def on_correction_sent(self, now: float) -> None:
        """Records that the correction was accepted, or is the last one: it must take effect from now on."""
        if self._correction is not None:
            self._correction.less_at = min(self._correction.less_at, now)

    def reset(self) -> None:
        """Resets the state when the motors are off."""
        self._beyond_since = self._correction = None

    def _within(self) -> Verdict | None:
        was_corrected = self._correction is not None
        self.reset()
        return Verdict.WITHIN if was_corrected else None

    def _check_correction(self, correction: _Correction, excess: float, now: float) -> Verdict | None:
        if excess <= self.still:
            self._correction = _Correction(now, now, excess)
            return None
        correction.sample(excess, now)
        has_failed = (
            now - correction.less_at >= self.time or now - correction.started_at >= LONGEST * self.time
        )
        if not has_failed:
            return None
        self._correction = _Correction(now, now, excess)
        return Verdict.FAILED


class _Correction:
    """The excess after a correction: decreasing, possibly after an initial increase.

    `less_at` is the time when it last decreased, initially the time from which it may decrease.
    """

    def __init__(self, now: float, less_at: float, excess: float) -> None:
        self.started_at, self.less_at = now, less_at
        self._minimum, self._has_decreased = excess, False

    def sample(self, excess: float, now: float) -> None:
        """Records a new minimum."""
        if excess <= self._minimum - LESS:
            self._minimum, self._has_decreased, self.less_at = excess, True, now
        elif not self._has_decreased:
            self._minimum = max(self._minimum, excess)


class Limits:
    """The limits of a binding, relative to home: `altitude` and `radius` in metres, `speed` in m/s.

    `error` creates the exception for a reason.
    """

    def __init__(self, binding: DeviceBinding, error: Callable[[str], DeviceError]) -> None:
        self._ttl, self._error = binding.ttl, error
        self._altitude = binding.limits.get("altitude", math.inf)
        self._radius = binding.limits.get("radius", math.inf)
        self._speed = binding.limits.get("speed", math.inf)

    @property
    def bound_places(self) -> bool:
        """Whether any position is forbidden."""
        return min(self._altitude, self._radius) < math.inf

    @property
    def places(self) -> tuple[float, float]:
        """The greatest distance from home and height above it, in metres; inf for none."""
        return self._radius, self._altitude

    @property
    def bounds_anything(self) -> bool:
        """Whether the binding has any limit."""
        return min(self._altitude, self._radius, self._speed) < math.inf

    @property
    def bounds_radius(self) -> bool:
        """Whether the distance from home is limited."""
        return self._radius < math.inf

    @property
    def bounds_speed(self) -> bool:
        """Whether the horizontal speed is limited."""
        return self._speed < math.inf

    def check_goal(self, subject: str, goal: Vector, extent: float = 0.0) -> None:
        """Refuses a goal that is not finite or is beyond the limits. Raises DeviceError.

        `extent` is the radius in metres of a circle around the goal.
        """
        north, east, down = goal
        if not all(map(math.isfinite, goal)):
            raise self._error(f"{subject} requires finite numbers")
        if -down > self._altitude + ROUNDED_HEIGHT:
            raise self._error(f"{subject} refused: {-down:g} m is above the limit of {self._altitude:g} m")
        distance = math.hypot(north, east) + extent
        if distance > self._radius + ROUNDED_PLACE:
            raise self._error(
                f"{subject} refused: {distance:.1f} m from home is beyond the limit of {self._radius:g} m"
            )

    def check_return(self, subject: str, height: float, parameter: str) -> None:
        """Refuses a return whose height, set by a parameter, is above the limit. Raises DeviceError."""
        if height > self._altitude + ROUNDED_HEIGHT:
            raise self._error(
                f"{subject} refused: it would climb to {height:g} m ({parameter}), above the limit of "
                f"{self._altitude:g} m; reduce {parameter}, or use goTo and land"
            )

    @property
    def bounds_heights(self) -> bool:
        return self._altitude < math.inf

    def check_speed(self, subject: str, speed: float) -> None:
        """Refuses a horizontal speed above the limit. Raises DeviceError."""
        if not (math.isfinite(speed) and speed <= self._speed * (1.0 + ROUNDED_SPEED)):
            raise self._error(f"{subject} of {speed:g} m/s is above the limit of {self._speed:g} m/s")

    def check_velocity(self, place: Vector | None, velocity: Vector) -> None:
        """Refuses a velocity that leaves the limits within its time-to-live plus braking, or leads farther
        out.

        Not checked without a position. Raises DeviceError.
        """
        if place is None:
            return
        duration = self._ttl + math.hypot(*velocity) / (2.0 * BRAKES)
        end = tuple(p + v * duration for p, v in zip(place, velocity, strict=True))
        if math.hypot(*end[:2]) > max(self._radius, math.hypot(*place[:2])):
            raise self._error(f"setVelocity refused: it leads beyond the limit of {self._radius:g} m")
        if -end[2] > max(self._altitude, -place[2]):
            raise self._error(f"setVelocity refused: it leads above the limit of {self._altitude:g} m")
