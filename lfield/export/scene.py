"""The map of viewers: positions and rotations (east, north, up), and the parts of Foxglove's scenes. Pure.

A body looks along its x axis; in the map its y axis points to its left and its z axis up (REP 103).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from lfield.export.channels import timestamp
from lfield.export.foxglove_schemas import PRIMITIVES

#: The frame of the map: east, north, up, in metres from the team's origin.
MAP_FRAME = "map"
#: The team's frame: north, east, down.
TEAM_FRAME = "team"


class MapPoint(NamedTuple):
    """Metres east, north and up of the team's origin."""

    x: float
    y: float
    z: float


class Rotation(NamedTuple):
    """A unit quaternion."""

    x: float
    y: float
    z: float
    w: float


NO_ROTATION = Rotation(0.0, 0.0, 0.0, 1.0)
#: The pose of the team's frame in the map: its x axis points north, its z axis down.
TEAM_IN_MAP = Rotation(math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)


def map_point(north: float, east: float, down: float) -> MapPoint:
    """A position of the team's frame in the map."""
    return MapPoint(east, north, -down)


def rotation(roll: float, pitch: float, yaw: float) -> Rotation:
    """The rotation by these angles about x, y and z (in this order, about axes that do not rotate)."""
    sin_r, cos_r = math.sin(roll / 2), math.cos(roll / 2)
    sin_p, cos_p = math.sin(pitch / 2), math.cos(pitch / 2)
    sin_y, cos_y = math.sin(yaw / 2), math.cos(yaw / 2)
    return Rotation(
        sin_r * cos_p * cos_y - cos_r * sin_p * sin_y,
        cos_r * sin_p * cos_y + sin_r * cos_p * sin_y,
        cos_r * cos_p * sin_y - sin_r * sin_p * cos_y,
        cos_r * cos_p * cos_y + sin_r * sin_p * sin_y,
    )


def attitude_in_map(roll: float, pitch: float, heading: float) -> Rotation:
    """The attitude of a vehicle in the map: its nose points `pitch` up, to `heading` clockwise from north."""
    return rotation(roll, -pitch, math.pi / 2 - heading)


def direction(start: MapPoint, end: MapPoint) -> tuple[Rotation, float]:
    """The rotation of the x axis to the direction of a line, and the length of the line."""
    x, y, z = (b - a for a, b in zip(start, end, strict=True))
    length = math.sqrt(x * x + y * y + z * z)
    return rotation(0.0, -math.atan2(z, math.hypot(x, y)), math.atan2(y, x)), length


# --- parts of a scene ---------------------------------------------------------------------------------------


def entity(time: float, id: str, lifetime: float = 0.0, **shapes: list[dict[str, Any]]) -> dict[str, Any]:
    """An entity in the map, shown for `lifetime` seconds, 0 for ever."""
    return {
        "timestamp": timestamp(time),
        "frame_id": MAP_FRAME,
        "id": id,
        "lifetime": timestamp(lifetime),
        "frame_locked": False,
        "metadata": [],
        **{name: shapes.get(name, []) for name in PRIMITIVES},
    }


def pose(point: MapPoint, turned: Rotation = NO_ROTATION) -> dict[str, Any]:
    """A pose in the map."""
    return {"position": point._asdict(), "orientation": turned._asdict()}


def rounded(point: MapPoint) -> dict[str, float]:
    """A point to the millimetre."""
    return {name: round(each, 3) for name, each in point._asdict().items()}


def color(red: float, green: float, blue: float) -> dict[str, float]:
    """An opaque colour."""
    return {"r": red, "g": green, "b": blue, "a": 1.0}
