"""What plans consist of: waypoints, zones of a fence, rally points, as items of the mission protocol.

https://mavlink.io/en/services/mission.html, https://mavlink.io/en/messages/common.html#mav_commands
Places are latitude and longitude in degrees; on the wire they are 1e-7 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from lfield_mavlink.link.dialect import AUTOPILOT, dialect

WAYPOINT = dialect.MAV_CMD_NAV_WAYPOINT
RALLY_POINT = dialect.MAV_CMD_NAV_RALLY_POINT
POLYGONS = (
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    dialect.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
CIRCLES = (dialect.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, dialect.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION)

#: Frames that mean the same: an item sent in the first may come back in the second.
_TWINS = {
    dialect.MAV_FRAME_GLOBAL_INT: dialect.MAV_FRAME_GLOBAL,
    dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT,
}
#: How much an autopilot may round: ArduPilot keeps heights in cm; PX4 keeps places in floating point.
_ROUND_HEIGHT, _ROUND_PLACE, _ROUND_PARAMETER = 0.0101, 1, 0.01
#: The most corners of one polygon: ArduPilot counts them in a byte.
MAX_CORNERS = 255


class PlanKind(IntEnum):
    """MAV_MISSION_TYPE: the plans that a vehicle keeps side by side."""

    MISSION = 0
    FENCE = 1
    RALLY = 2

    @property
    def word(self) -> str:
        """As in a sentence."""
        return ("mission", "fence", "list of rally points")[self]


@dataclass(frozen=True, slots=True)
class Item:
    """One item of a plan: a MAV_CMD at a place. `x` and `y` are 1e-7 degrees, `z` metres in its frame."""

    command: int
    frame: int
    x: int
    y: int
    z: float = 0.0
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @classmethod
    def of(cls, message: Any) -> Item:
        """The item in a MISSION_ITEM_INT."""
        values = (message.param1, message.param2, message.param3, message.param4)
        return cls(message.command, message.frame, message.x, message.y, message.z, values)

    def message(self, system: int, number: int, kind: PlanKind) -> Any:
        """The MISSION_ITEM_INT that carries it as the number-th of its plan."""
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
        """Whether `z` is a height above the ground below, wherever that is."""
        return bool(_TWINS.get(self.frame, self.frame) == dialect.MAV_FRAME_GLOBAL_TERRAIN_ALT)

    def same(self, other: Item) -> bool:
        """Whether it is the same item, as far as an autopilot keeps it.

        The first parameter counts (hold time, radius, number of corners); of the others, autopilots drop
        what they have no use for.
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


#: What stands at the place of home in a mission of ArduPilot, which puts its own home there.
HOME = Item(WAYPOINT, dialect.MAV_FRAME_GLOBAL, 0, 0)


def place(latitude: float, longitude: float) -> tuple[int, int]:
    """A place in 1e-7 degrees. Raises ValueError with a sentence when it is none on earth."""
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):  # so that NaN is refused too
        raise ValueError(f"latitude {latitude:g}, longitude {longitude:g} is no place in degrees")
    return round(latitude * 1e7), round(longitude * 1e7)


def points(values: Sequence[float], width: int, what: str) -> Iterator[Sequence[float]]:
    """Cut a flat array into points of `width` numbers. Raises ValueError with a sentence."""
    if not values or len(values) % width:
        names = "{latitude, longitude, height}" if width == 3 else "{latitude, longitude}"
        raise ValueError(f"{what} are given as {names} for each, {len(values)} numbers are not that")
    return (values[start : start + width] for start in range(0, len(values), width))


def waypoints(values: Sequence[float], *, yaw: float) -> list[Item]:
    """{latitude, longitude, height above home} for each waypoint. Raises ValueError.

    `yaw` is what "the nose where it flies" is for this autopilot: NaN for PX4, 0 for ArduPilot.
    """
    frame, parameters = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, (0.0, 0.0, 0.0, yaw)
    return [
        Item(WAYPOINT, frame, *place(latitude, longitude), _height(height), parameters)
        for latitude, longitude, height in points(values, 3, "waypoints")
    ]


def rally_points(values: Sequence[float]) -> list[Item]:
    """{latitude, longitude, height above home} for each rally point. Raises ValueError."""
    frame = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
    return [
        Item(RALLY_POINT, frame, *place(latitude, longitude), _height(height))
        for latitude, longitude, height in points(values, 3, "rally points")
    ]


def coordinates(items: Sequence[Item], command: int) -> list[float]:
    """The inverse: three numbers for each item. Raises ValueError for items that are something else."""
    values: list[float] = []
    for number, item in enumerate(items):
        if item.command != command or not item.above_home:
            raise ValueError(
                f"item {number} is {command_name(item.command)} in frame {item.frame}, "
                "which {latitude, longitude, height above home} cannot say"
            )
        values += (item.x / 1e7, item.y / 1e7, item.z)
    return values


def circle(latitude: float, longitude: float, radius: float, *, inside: bool) -> list[Item]:
    """A zone to stay inside, or outside. Raises ValueError."""
    if not 0.0 < radius < math.inf:
        raise ValueError(f"a circle needs a radius above 0, not {radius:g}")
    command = CIRCLES[0 if inside else 1]
    parameters = (radius, 0.0, 0.0, 0.0)
    return [Item(command, dialect.MAV_FRAME_GLOBAL, *place(latitude, longitude), 0.0, parameters)]


def polygon(corners: Sequence[float], *, inside: bool) -> list[Item]:
    """A zone with {latitude, longitude} for each corner. Raises ValueError."""
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
