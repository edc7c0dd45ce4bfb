"""The limits of the binding: a goal or a speed beyond them is refused before anything is sent. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield.driver import DeviceBinding, DeviceError
from lfield_mavlink.geo import Vector


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

    def check_circle(self, what: str, centre: Vector, radius: float) -> None:
        """Refuse a circle whose place farthest from home is beyond the limits. Raises DeviceError."""
        far = math.hypot(*centre[:2])
        if far == 0.0:
            self.check_goal(what, (radius, 0.0, centre[2]))
        else:
            share = (far + radius) / far
            self.check_goal(what, (centre[0] * share, centre[1] * share, centre[2]))

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
