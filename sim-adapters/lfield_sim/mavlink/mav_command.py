"""A received command, from COMMAND_LONG or COMMAND_INT."""

from __future__ import annotations

import math
from typing import Any

from msgspec import Struct

from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.flavours import MavResult
from lfield_sim.mavlink.geo import ABOVE_HOME, GeoOrigin, is_near

#: An unused integer coordinate.
NO_COORDINATE = 0x7FFFFFFF


class DelayedResult(Struct, frozen=True):
    """A result after some seconds; `progress`: IN_PROGRESS is sent meanwhile."""

    result: MavResult
    seconds: float
    progress: bool = False


#: A result, or None for silence, and messages that follow the acknowledgement.
CommandAnswer = tuple[MavResult | DelayedResult | None, list[Any]]


class MavCommand(Struct, frozen=True):
    """A command's number and seven values.

    `frame` is a MAV_FRAME for COMMAND_INT, whose values 5 and 6 are in 1e-7 degrees. With COMMAND_LONG
    (`frame` None) they are in degrees, and the height is above mean sea level. `source` are the system and
    component of its sender, (0, 0) for an item of the autopilot's own mission.
    """

    number: int
    values: tuple[float, ...]
    frame: int | None = None
    source: tuple[int, int] = (0, 0)

    def value(self, index: int) -> float:
        """Parameter `index`, counted from 1 as in the MAVLink tables; NaN reads as 0."""
        value = self.values[index - 1]
        return 0.0 if math.isnan(value) else value

    def optional(self, index: int) -> float | None:
        """Parameter `index`, None when it is NaN or infinite: left to the autopilot."""
        value = self.values[index - 1]
        return value if math.isfinite(value) else None

    def whole(self, index: int) -> int:
        """Parameter `index` as an integer; -1 if it is not one."""
        value = self.value(index)
        return int(value) if math.isfinite(value) else -1

    def place(self, origin: GeoOrigin, present: Vector, home: Vector) -> Vector | None:
        """The position in parameters 5 to 7, in the local frame; None if invalid.

        A missing coordinate is that of `present`.
        """
        scale = 1.0 if self.frame is not None else 1e7
        x, y = self.optional(5), self.optional(6)
        if x is None or y is None or NO_COORDINATE in (x, y):
            north, east = present[:2]
        else:
            north, east = origin.local(x * scale, y * scale)
        z = self.optional(7)
        down = present[2] if z is None else home[2] - z if self.frame in ABOVE_HOME else origin.altitude - z
        place = (north, east, down)
        return place if is_near(place) else None
