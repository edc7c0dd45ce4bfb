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

#: The share of its greatest excess since the last look to which a correction that helps has brought it by the
#: next. What was told to be slower while it still gained speed needs a moment to lose the first of it.
HELPING = 0.9


class Verdict(Enum):
    """What becomes of a value: it must be corrected, cannot be, or is within its limit again."""

    CORRECT = auto()
    HELPLESS = auto()
    WITHIN = auto()


@dataclass(slots=True)
class LimitWatch:
    """Samples of one value against its limit, with room for gusts and noise.

    `bound` is the limit with its tolerance. A value that is beyond it for `time` seconds without a break must
    be corrected. Then, every `time` seconds, the excess must be on its way down, or at most `still`: else the
    correction does not help. The excess of a speed is what is above the bound, that of a place the speed
    at which it leads farther out. What was not heard for `time` is not known to have been beyond anything.
    """

    bound: float
    time: float
    still: float = 0.0
    _beyond_since: float | None = None
    _heard_at: float = -math.inf
    _look_at: float | None = None
    _excess: float = 0.0

    def sample(self, value: float, excess: float, now: float) -> Verdict | None:
        """Take one sample in; what is to be done about it, if that is news."""
        gap, self._heard_at = now - self._heard_at, now
        if value <= self.bound:
            return self._within()
        if self._beyond_since is None or (self._look_at is None and gap > self.time):
            self._beyond_since = now
        if self._look_at is None:
            return self._correct(excess, now) if now - self._beyond_since >= self.time else None
        self._excess = max(self._excess, excess)
        return self._look(excess, now) if now >= self._look_at else None

    def reset(self) -> None:
        """Nothing is known any more, since its motors are off."""
        self._beyond_since = self._look_at = None

    def _within(self) -> Verdict | None:
        corrected = self._look_at is not None
        self.reset()
        return Verdict.WITHIN if corrected else None

    def _correct(self, excess: float, now: float) -> Verdict:
        self._look_at, self._excess = now + self.time, excess
        return Verdict.CORRECT

    def _look(self, excess: float, now: float) -> Verdict | None:
        helpless = excess > max(self.still, HELPING * self._excess)
        self._look_at, self._excess = now + self.time, excess
        return Verdict.HELPLESS if helpless else None


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

    def check_goal(self, what: str, goal: Vector) -> None:
        """Refuse a goal that is no place, or beyond the limits. Raises DeviceError."""
        north, east, down = goal
        if not all(map(math.isfinite, goal)):
            raise self._error(f"{what} needs finite numbers")
        if -down > self._altitude:
            raise self._error(f"{what} refused: {-down:g} m is above the limit of {self._altitude:g} m")
        far = math.hypot(north, east)
        if far > self._radius:
            raise self._error(
                f"{what} refused: {far:.1f} m from home is beyond the limit of {self._radius:g} m"
            )

    def check_speed(self, what: str, speed: float) -> None:
        """Refuse a speed over ground above the limit. Raises DeviceError."""
        if not (math.isfinite(speed) and speed <= self._speed):
            raise self._error(f"{what} of {speed:g} m/s is above the limit of {self._speed:g} m/s")

    def check_way_out(self, place: Vector | None, velocity: Vector) -> None:
        """Refuse a velocity that leads out of the limits before its time-to-live is over, or farther out.

        Without a place nothing is known of that. Raises DeviceError.
        """
        if place is None:
            return
        ahead = tuple(p + v * self._ttl for p, v in zip(place, velocity, strict=True))
        if math.hypot(*ahead[:2]) > max(self._radius, math.hypot(*place[:2])):
            raise self._error(f"setVelocity refused: it leads beyond the limit of {self._radius:g} m")
        if -ahead[2] > max(self._altitude, -place[2]):
            raise self._error(f"setVelocity refused: it leads above the limit of {self._altitude:g} m")
