"""A plan as one compact text, for programs: the name of its file, then the plan as QGroundControl's JSON.

The text contains only data that a vehicle needs: items (surveys expanded), fence, rally points, home,
firmware and kind. So equal plans of different programs have equal texts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from lfield.driver import MissionFileError, PlanZone
from lfield_mavlink.files.plan_file import FIRMWARES, MAV_TYPES, PlanFile
from lfield_mavlink.files.plan_report import read_plan_file
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_check import HERE
from lfield_mavlink.services.plan_items import Item

_DIGITS = 7


def embedded_plan(name: str, data: bytes) -> str:
    """The text of a plan for a program. Raises MissionFileError."""
    return plan_text(read_plan_file(name, data))


def plan_text(plan: PlanFile) -> str:
    """The text of a plan; its file without folders is the first line."""
    first = plan.items[0].number if plan.items else 1
    home = plan.home
    tree = {
        "fileType": "Plan",
        "version": 1,
        "mission": {
            "version": 2,
            "firmwareType": FIRMWARES.get(plan.firmware, 0),
            "vehicleType": MAV_TYPES.get(plan.kind, 0),
            "cruiseSpeed": plan.cruise_speed,
            "hoverSpeed": plan.hover_speed,
            "plannedHomePosition": None if home is None else [home.latitude, home.longitude, home.altitude],
            "items": [_simple(each.number - first + 1, each.item, first) for each in plan.items],
        },
        "geoFence": {
            "version": 2,
            "polygons": [_polygon(zone) for zone in plan.fence if len(zone.corners) != 1],
            "circles": [_circle(zone) for zone in plan.fence if len(zone.corners) == 1],
        },
        "rallyPoints": {
            "version": 2,
            "points": [[point.latitude, point.longitude, point.height] for point in plan.rally],
        },
    }
    return f"{plan.file.rpartition('/')[2]}\n{msgspec.json.encode(tree).decode()}"


def read_plan_text(text: str) -> PlanFile:
    """The plan of a text of `plan_text`, or of a file without a name. Raises MissionFileError."""
    name, newline, body = text.partition("\n")
    if not newline or name.startswith(("{", "QGC")):
        name, body = "plan", text
    try:
        data = body.encode()
    except UnicodeEncodeError:
        raise MissionFileError("plan", "its text is not valid Unicode") from None
    return read_plan_file(name[:200], data)


def _simple(number: int, item: Item, first: int) -> dict[str, Any]:
    scale = 1 if item.frame == dialect.MAV_FRAME_MISSION else 1e7
    place = [None if value == HERE else round(value / scale, _DIGITS) for value in (item.x, item.y)]
    values = [None if math.isnan(value) else value for value in (*item.parameters, item.z)]
    if item.command in (dialect.MAV_CMD_DO_JUMP, dialect.MAV_CMD_DO_SET_MISSION_CURRENT):
        values[0] = item.parameters[0] - first + 1
    return {
        "type": "SimpleItem",
        "doJumpId": number,
        "command": item.command,
        "frame": item.frame,
        "params": [*values[:4], *place, values[4]],
    }


def _polygon(zone: PlanZone) -> Mapping[str, Any]:
    return {"inclusion": zone.inclusion, "polygon": _rounded(zone.corners)}


def _circle(zone: PlanZone) -> Mapping[str, Any]:
    circle = {"center": _rounded(zone.corners)[0], "radius": zone.radius}
    return {"inclusion": zone.inclusion, "circle": circle}


def _rounded(corners: Sequence[tuple[float, float]]) -> list[list[float]]:
    return [[round(value, _DIGITS) for value in corner] for corner in corners]
