"""Items of QGroundControl's patterns.

A survey and a corridor scan are saved with their items. A landing pattern is saved by its parameters, from
which its items follow: DO_LAND_START, the ends of photos and of video, the approach, the landing
(LandingComplexItem.cc of QGroundControl). A structure scan is saved without its items, which depend on the
camera.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from lfield_mavlink.link.dialect import dialect

#: Names for people, by `complexItemType`.
PATTERNS: Mapping[str, str] = {
    "survey": "survey",
    "CorridorScan": "corridor scan",
    "StructureScan": "structure scan",
    "fwLandingPattern": "landing pattern",
    "vtolLandingPattern": "landing pattern",
}
_AIRSPEED = 0.0


class _Landing(msgspec.Struct, rename="camel"):
    """Parameters of a landing pattern; the deprecated names are of version 1."""

    loiter_radius: float
    loiter_clockwise: bool
    land_coordinate: list[float]
    landing_approach_coordinate: list[float] | None = None
    loiter_coordinate: list[float] | None = None
    altitudes_are_relative: bool | None = None
    loiter_altitude_relative: bool = True
    land_altitude_relative: bool = True
    use_loiter_to_alt: bool = True
    stop_taking_photos: bool = False
    #: A name that QGroundControl itself misspells.
    stop_video_photos: bool = False
    use_do_change_speed: bool = False
    final_approach_speed: float = 0.0


def pattern_items(tree: Mapping[str, Any]) -> Sequence[Any]:
    """The simple items of a complex item, as JSON. Raises ValueError, msgspec.ValidationError."""
    match tree.get("complexItemType"):
        case "survey" | "CorridorScan":
            return _saved_items(tree)
        case "fwLandingPattern":
            return _landing_items(msgspec.convert(dict(tree), _Landing), dialect.MAV_CMD_NAV_LAND)
        case "vtolLandingPattern":
            return _landing_items(msgspec.convert(dict(tree), _Landing), dialect.MAV_CMD_NAV_VTOL_LAND)
        case "StructureScan":
            raise ValueError(
                "QGroundControl saves no items for it; upload it, download it from the vehicle, and save that"
            )
        case _:
            raise ValueError(f"lfield does not know this pattern; it knows {', '.join(PATTERNS)}")


def pattern_area(tree: Mapping[str, Any]) -> list[tuple[tuple[float, float], ...]]:
    """The polygon of a survey, for drawings; empty for other patterns and an unreadable polygon."""
    try:
        corners = msgspec.convert(tree.get("polygon") or [], list[tuple[float, float]])
    except msgspec.ValidationError:
        return []
    return [tuple(corners)] if len(corners) > 2 else []


def _saved_items(tree: Mapping[str, Any]) -> Sequence[Any]:
    transects = tree.get("TransectStyleComplexItem")
    items = transects.get("Items") if isinstance(transects, dict) else None
    if transects is None or not isinstance(items, list):
        raise ValueError("it is saved without its items; open it in a newer QGroundControl and save it again")
    # Without a version: QGroundControl before 3.4, with the same items.
    if transects.get("version") not in (None, 1, 2):
        raise ValueError(f"its items have version {transects.get('version')}; lfield reads versions 1 and 2")
    return items


def _landing_items(landing: _Landing, command: int) -> Sequence[Any]:
    approach = landing.landing_approach_coordinate or landing.loiter_coordinate
    if approach is None or len(approach) != 3 or len(landing.land_coordinate) != 3:
        raise ValueError("its approach or its landing is not [latitude, longitude, altitude]")
    relative = landing.altitudes_are_relative
    if relative is None:
        # Version 1 had one each; QGroundControl takes different ones as relative.
        relative = landing.loiter_altitude_relative or landing.land_altitude_relative
    frame = dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT if relative else dialect.MAV_FRAME_GLOBAL
    nothing = dialect.MAV_FRAME_MISSION
    items = [_item(dialect.MAV_CMD_DO_LAND_START, nothing, [0.0] * 7)]
    if landing.use_do_change_speed:
        speed = [_AIRSPEED, landing.final_approach_speed, -1.0, 0.0, 0.0, 0.0, 0.0]
        items.append(_item(dialect.MAV_CMD_DO_CHANGE_SPEED, nothing, speed))
    if landing.stop_taking_photos:
        items.append(_item(dialect.MAV_CMD_DO_SET_CAM_TRIGG_DIST, nothing, [0.0] * 7))
        items.append(_item(dialect.MAV_CMD_IMAGE_STOP_CAPTURE, nothing, [0.0, *[math.nan] * 6]))
    if landing.stop_video_photos:
        items.append(_item(dialect.MAV_CMD_VIDEO_STOP_CAPTURE, nothing, [0.0, *[math.nan] * 6]))
    if landing.use_loiter_to_alt:
        radius = landing.loiter_radius * (1.0 if landing.loiter_clockwise else -1.0)
        items.append(_item(dialect.MAV_CMD_NAV_LOITER_TO_ALT, frame, [1.0, radius, 0.0, 1.0, *approach]))
    else:
        items.append(_item(dialect.MAV_CMD_NAV_WAYPOINT, frame, [0.0, 0.0, 0.0, math.nan, *approach]))
    items.append(_item(command, frame, [0.0, 0.0, 0.0, 0.0, *landing.land_coordinate]))
    return items


def _item(command: int, frame: int, params: Sequence[float]) -> dict[str, Any]:
    values = [None if math.isnan(value) else value for value in params]
    return {"command": command, "frame": frame, "params": values}
