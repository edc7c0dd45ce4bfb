"""Items of the mission protocol: waypoints, fence zones, rally points.

https://mavlink.io/en/services/mission.html, https://mavlink.io/en/messages/common.html#mav_commands Positions
are latitude and longitude in degrees; on the wire in 1e-7 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from enum import IntEnum
from typing import Any

from msgspec import Struct

from lfield_mavlink.link.dialect import AUTOPILOT, dialect

WAYPOINT = dialect.MAV_CMD_NAV_WAYPOINT
RALLY_POINT = dialect.MAV_CMD_NAV_RALLY_POINT
POLYGONS = (
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
CIRCLES = (dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)

#: Equivalent frames: an item sent in the first may be returned in the second.
_TWINS = {
    dialect.MAV_FRAME_GLOBAL_INT: dialect.MAV_FRAME_GLOBAL,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT,
}
#: Rounding by autopilots: ArduPilot stores heights in cm; PX4 stores positions as floats.
_ROUND_HEIGHT, _ROUND_PLACE, _ROUND_PARAMETER = 0.0101, 1, 0.01
#: Maximum corners of a polygon: ArduPilot counts them in a byte.
MAX_CORNERS = 255


class PlanKind(IntEnum):
    """MAV_MISSION_TYPE: the independent plans of a vehicle."""

    MISSION = 0
    FENCE = 1
    RALLY = 2

    @property
    def noun(self) -> str:
        """The name of the kind in a sentence."""
        return ("mission", "fence", "list of rally points")[self]


class Item(Struct, frozen=True):
    """One item of a plan: a MAV_CMD at a position. `x` and `y` are 1e-7 degrees, `z` metres in its frame."""

    command: int
    frame: int
    x: int
    y: int
    z: float = 0.0
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @classmethod
    def from_message(cls, message: Any) -> Item:
        """The item in a MISSION_ITEM_INT."""
        values = (message.param1, message.param2, message.param3, message.param4)
        return cls(message.command, message.frame, message.x, message.y, message.z, values)

    def message(self, system: int, number: int, kind: PlanKind) -> Any:
        """The MISSION_ITEM_INT for the item as the number-th of its plan."""
        return dialect.MAVLink_mission_item_int_message(
            system, AUTOPILOT, number, self.frame, self.command, 0, 1, *self.parameters, self.x, self.y,
            self.z, int(kind),
        )  # fmt: skip

    @property
    def above_sea(self) -> bool:
        """Whether `z` is a height above mean sea level."""
        return bool(_TWINS.get(self.frame, self.frame) == dialect.MAV_FRAME_GLOBAL)

    @property
    def above_home(self) -> bool:
        """Whether `z` is a height above home."""
        return bool(_TWINS.get(self.frame, self.frame) == dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT)

    @property
    def above_terrain(self) -> bool:
        """Whether `z` is a height above the terrain."""
        return bool(_TWINS.get(self.frame, self.frame) == dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT)

    def matches(self, other: Item) -> bool:
        """Whether another item is this one after storage in an autopilot.

        The first parameter is compared (hold time, radius, number of corners); autopilots drop others that
        they do not use.
        """
        frames = [_TWINS.get(frame, frame) for frame in (self.frame, other.frame)]
        return (
            self.command == other.command
            and frames[0] == frames[1]
            and abs(self.x - other.x) <= _ROUND_PLACE
            and abs(self.y - other.y) <= _ROUND_PLACE
            and abs(self.z - other.z) <= _ROUND_HEIGHT
            and abs(self.parameters[0] - other.parameters[0]) <= _ROUND_PARAMETER
        )


#: Placeholder for home in a mission of ArduPilot, which inserts its own.
HOME = Item(WAYPOINT, dialect.MAV_FRAME_GLOBAL, 0, 0)


def place(latitude: float, longitude: float) -> tuple[int, int]:
    """A position in 1e-7 degrees. Raises ValueError if it is impossible."""
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # refuses NaN as well
        raise ValueError(f"latitude {latitude:g}, longitude {longitude:g} is not a position in degrees")
    return round(latitude * 1e7), round(longitude * 1e7)


def points(values: Sequence[float], width: int, noun: str) -> Iterator[Sequence[float]]:
    """Splits a flat array into points of `width` numbers. Raises ValueError."""
    if not values or len(values) % width:
        names = "{latitude, longitude, height}" if width == 3 else "{latitude, longitude}"
        raise ValueError(f"{noun} need {names} each, which {len(values)} numbers are not")
    return (values[start : start + width] for start in range(0, len(values), width))


def waypoints(values: Sequence[float], *, yaw: float) -> list[Item]:
    """{latitude, longitude, height above home} per waypoint. Raises ValueError.

    `yaw` is this autopilot's value for "heading along the path": NaN for PX4, 0 for ArduPilot.
    """
    frame, parameters = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, (0.0, 0.0, 0.0, yaw)
    return [
        Item(WAYPOINT, frame, *place(latitude, longitude), _height(height), parameters)
        for latitude, longitude, height in points(values, 3, "waypoints")
    ]


def rally_points(values: Sequence[float]) -> list[Item]:
    """{latitude, longitude, height above home} per rally point. Raises ValueError."""
    frame = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    return [
        Item(RALLY_POINT, frame, *place(latitude, longitude), _height(height))
        for latitude, longitude, height in points(values, 3, "rally points")
    ]


def coordinates(items: Sequence[Item], command: int) -> list[float]:
    """The inverse of `waypoints` and `rally_points`: three numbers per item. Raises ValueError for other
    items.
    """
    values: list[float] = []
    for number, item in enumerate(items):
        if item.command != command or not item.above_home:
            raise ValueError(
                f"item {number} is {command_name(item.command)} in frame {item.frame}, which is not "
                f"{{latitude, longitude, height above home}}"
            )
        values += (item.x / 1e7, item.y / 1e7, item.z)
    return values


def circle(latitude: float, longitude: float, radius: float, *, inside: bool) -> list[Item]:
    """An inclusion or exclusion circle. Raises ValueError."""
    if not 0.0 < radius < math.inf:
        raise ValueError(f"a circle requires a radius above 0, not {radius:g}")
    command = CIRCLES[0 if inside else 1]
    parameters = (radius, 0.0, 0.0, 0.0)
    return [Item(command, dialect.MAV_FRAME_GLOBAL, *place(latitude, longitude), 0.0, parameters)]


def polygon(corners: Sequence[float], *, inside: bool) -> list[Item]:
    """An inclusion or exclusion polygon with {latitude, longitude} per corner. Raises ValueError."""
    pairs = list(points(corners, 2, "corners"))
    if not 3 <= len(pairs) <= MAX_CORNERS:
        raise ValueError(f"a polygon has 3 to {MAX_CORNERS} corners, not {len(pairs)}")
    command, parameters = POLYGONS[0 if inside else 1], (float(len(pairs)), 0.0, 0.0, 0.0)
    return [Item(command, dialect.MAV_FRAME_GLOBAL, *place(*pair), 0.0, parameters) for pair in pairs]


def command_name(command: int) -> str:
    """`NAV_TAKEOFF (22)`."""
    entry = dialect.enums["MAV_CMD"].get(command)
    return f"{entry.name.removeprefix('MAV_CMD_')} ({command})" if entry else f"command {command}"


def _height(height: float) -> float:
    if not math.isfinite(height):
        raise ValueError(f"a height must be a finite number, not {height}")
    return height
