"""The content of a mission file, independent of its format."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct
from msgspec.structs import replace

from lfield.driver import MissionFileError, PlanZone
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4
from lfield_mavlink.services.mission_check import HERE
from lfield_mavlink.services.plan_items import CIRCLES, POLYGONS, RALLY_POINT, Item

#: MAV_AUTOPILOT by the name of the option `autopilot`.
FIRMWARES: Mapping[str, int] = {"ardupilot": ARDUPILOT, "px4": PX4}
#: MAV_TYPEs by kind of vehicle; the driver's own kind `plane` includes those that take off vertically.
_TYPES: Mapping[str, frozenset[int]] = {
    "copter": frozenset({2, 3, 4, 13, 14, 15, 29, 35}),
    "plane": frozenset({1}),
    "vtol": frozenset(range(19, 26)),
    "rover": frozenset({10, 11}),
    "submarine": frozenset({12}),
}
KINDS = tuple(_TYPES)
#: A typical MAV_TYPE of each kind.
MAV_TYPES: Mapping[str, int] = {kind: min(numbers) for kind, numbers in _TYPES.items()}
#: The most items that one file may have; a MAVLink mission is counted by 16 bits.
MAX_ITEMS = 0xFFFF
_FRAMES_WITHOUT_PLACE = frozenset({dialect.MAV_FRAME_MISSION})
_JUMPS = (dialect.MAV_CMD_DO_JUMP, dialect.MAV_CMD_DO_SET_MISSION_CURRENT)
_INT32, _FLOAT32 = 0x7FFFFFFF, 3.4e38


class NumberedItem(Struct, frozen=True):
    """One item of a mission with its number in the ground station, and the pattern that it is a part of."""

    number: int
    item: Item
    part_of: str = ""


class RallyPoint(Struct, frozen=True):
    """A position in degrees, with metres above home."""

    latitude: float
    longitude: float
    height: float


class PlanFile(Struct, frozen=True):
    """A mission with its fence and rally points.

    `firmware` is `ardupilot`, `px4` or '' for unknown; `kind` one of KINDS or ''. Speeds are in m/s, None if
    the file has none. `areas` are the polygons of its surveys. A jump refers to the number of its target.
    """

    file: str
    items: tuple[NumberedItem, ...] = ()
    home: Place | None = None
    fence: tuple[PlanZone, ...] = ()
    rally: tuple[RallyPoint, ...] = ()
    firmware: str = ""
    kind: str = ""
    cruise_speed: float | None = None
    hover_speed: float | None = None
    areas: tuple[tuple[tuple[float, float], ...], ...] = ()

    def mission(self, *, px4: bool) -> list[Item]:
        """The items for a vehicle: PX4 numbers them from 0 in jumps, ArduPilot from 1, after home.

        PX4 has NaN for values that are not used, which ArduPilot refuses in most commands, and for its own
        position, for which ArduPilot has 0, 0.
        """
        first = self.items[0].number if self.items else 1
        shift = first - (0 if px4 else 1)
        items = [_renumbered(numbered.item, shift) for numbered in self.items]
        return items if px4 else [_without_nan(item) for item in items]


def firmware_name(number: int) -> str:
    """`px4` of 12; '' for a firmware that this driver does not know."""
    return next((name for name, autopilot in FIRMWARES.items() if autopilot == number), "")


def vehicle_kind(number: int) -> str:
    """`copter` of 2; '' for a generic or unknown MAV_TYPE."""
    return next((kind for kind, numbers in _TYPES.items() if number in numbers), "")


def mission_item(command: int, frame: int, values: Sequence[float]) -> Item:
    """An item of seven parameters, of which 5 and 6 are a position in degrees except in MAV_FRAME_MISSION.

    NaN as a position is the vehicle's own. Raises ValueError.
    """
    if not (0 <= command <= 0xFFFF and 0 <= frame <= 0xFF):
        raise ValueError(f"command {command} in frame {frame} does not exist")
    if any(abs(value) > _FLOAT32 for value in values):
        raise ValueError("a parameter is infinite, or larger than MAVLink can transmit")
    scale = 1.0 if frame in _FRAMES_WITHOUT_PLACE else 1e7
    x, y = (_scaled(value, scale) for value in values[4:6])
    first, second, third, fourth = values[:4]
    return Item(command, frame, x, y, values[6], (first, second, third, fourth))


def zones_and_points(file: str, rows: Sequence[NumberedItem]) -> tuple[list[PlanZone], list[RallyPoint]]:
    """The fence and the rally points among the items of a file. Raises MissionFileError."""
    zones, points, corners = list[PlanZone](), list[RallyPoint](), list[tuple[float, float]]()
    for row in rows:
        item, place = row.item, (row.item.x / 1e7, row.item.y / 1e7)
        if item.command == RALLY_POINT:
            points.append(RallyPoint(*place, item.z))
        elif item.command in CIRCLES:
            zones.append(PlanZone(item.command == CIRCLES[0], (place,), item.parameters[0]))
        elif item.command in POLYGONS:
            corners.append(place)
            if len(corners) == item.parameters[0]:
                zones.append(PlanZone(item.command == POLYGONS[0], tuple(corners)))
                corners = []
    if corners:
        reason = (
            f"a polygon of the fence ends after {len(corners)} corners, and its items name another number"
        )
        raise MissionFileError(file, reason, item=rows[-1].number)
    return zones, points


def _scaled(value: float, scale: float) -> int:
    if math.isnan(value):
        return HERE
    if not abs(value * scale) < _INT32:
        raise ValueError(f"{value:g} is out of range of a position")
    return round(value * scale)


def _without_nan(item: Item) -> Item:
    first, second, third, fourth = (0.0 if math.isnan(value) else value for value in item.parameters)
    x, y = (0 if value == HERE else value for value in (item.x, item.y))
    return replace(item, parameters=(first, second, third, fourth), x=x, y=y)


def _renumbered(item: Item, shift: int) -> Item:
    if not shift or item.command not in _JUMPS:
        return item
    return replace(item, parameters=(item.parameters[0] - shift, *item.parameters[1:]))
