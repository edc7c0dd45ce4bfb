"""Reads QGroundControl's `.plan`: mission, fence and rally points as JSON.

https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html. An item's number is its place
in the list that is uploaded, from 1, as QGroundControl shows it; home is 0. A survey or a corridor scan
contributes the items that QGroundControl saved for it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import msgspec

from lfield.driver import MissionFileError, PlanZone, utf8_bytes
from lfield_mavlink.files.complex_items import PATTERNS, pattern_area, pattern_items
from lfield_mavlink.files.plan_file import (
    MAX_ITEMS,
    NumberedItem,
    PlanFile,
    RallyPoint,
    firmware_name,
    mission_item,
    vehicle_kind,
)
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import dialect

_JUMPS = (dialect.MAV_CMD_DO_JUMP, dialect.MAV_CMD_DO_SET_MISSION_CURRENT)


class _Circle(msgspec.Struct):
    center: list[float]
    radius: float


class _CircleZone(msgspec.Struct):
    circle: _Circle
    inclusion: bool = True


class _PolygonZone(msgspec.Struct):
    polygon: list[list[float | None]]
    inclusion: bool = True


class _Fence(msgspec.Struct):
    version: int = 2
    circles: list[_CircleZone] = []
    polygons: list[_PolygonZone] = []
    #: Of version 1: one zone.
    polygon: list[list[float | None]] = []


class _Rally(msgspec.Struct):
    points: list[list[float]] = []


class _Mission(msgspec.Struct, rename="camel"):
    version: int
    items: list[Any] = []
    firmware_type: int = 0
    vehicle_type: int = 0
    cruise_speed: float | None = None
    hover_speed: float | None = None
    planned_home_position: list[float | None] | None = None


class _Plan(msgspec.Struct, rename="camel"):
    file_type: str
    version: int
    mission: _Mission
    geo_fence: _Fence = msgspec.field(default_factory=_Fence)
    rally_points: _Rally = msgspec.field(default_factory=_Rally)


class SimpleItem(msgspec.Struct, rename="camel"):
    """One MAV_CMD as QGroundControl saves it; null stands for NaN."""

    command: int
    frame: int
    params: list[float | None]
    do_jump_id: int | None = None

    def numbers(self) -> list[float]:
        """The seven parameters. Raises ValueError for another number of them."""
        if len(self.params) != 7:
            raise ValueError(f"it has {len(self.params)} params instead of 7")
        return [math.nan if value is None else value for value in self.params]


def read_plan(file: str, data: bytes) -> PlanFile:
    """The content of a `.plan`. Raises MissionFileError."""
    plan = _decoded(file, data)
    if plan.file_type != "Plan" or plan.version != 1:
        reason = f"it is a file of type '{plan.file_type[:40]}', version {plan.version}; lfield reads Plan, 1"
        raise MissionFileError(file, reason)
    mission = plan.mission
    if mission.version != 2:
        raise MissionFileError(file, f"its mission has version {mission.version}; lfield reads version 2")
    reader = _ItemReader(file)
    reader.read(mission.items)
    return PlanFile(
        file,
        tuple(reader.numbered()),
        _home(file, mission.planned_home_position),
        tuple(_zones(file, plan.geo_fence)),
        tuple(_rally(file, plan.rally_points)),
        firmware_name(mission.firmware_type),
        vehicle_kind(mission.vehicle_type),
        mission.cruise_speed,
        mission.hover_speed,
        tuple(reader.areas),
    )


def _decoded(file: str, data: bytes) -> _Plan:
    try:
        return msgspec.json.decode(utf8_bytes(file, data), type=_Plan)
    except msgspec.ValidationError as error:
        raise MissionFileError(file, f"it is not a plan of QGroundControl: {error}") from None
    except (msgspec.DecodeError, RecursionError) as error:
        raise MissionFileError(file, f"not JSON: {error}") from None


class _ItemReader(msgspec.Struct):
    """Expands the items of a mission in order."""

    file: str
    items: list[tuple[SimpleItem, str]] = msgspec.field(default_factory=list)
    areas: list[tuple[tuple[float, float], ...]] = msgspec.field(default_factory=list)

    def read(self, trees: Sequence[Any]) -> None:
        for tree in trees:
            number = len(self.items) + 1
            if not isinstance(tree, dict):
                raise MissionFileError(self.file, "it is not an object", item=number)
            kind = tree.get("type")
            if kind == "SimpleItem":
                self.items.append((self._simple(tree, number), ""))
            elif kind == "ComplexItem":
                self._read_complex(tree, number)
            else:
                raise MissionFileError(self.file, f"its type '{str(kind)[:40]}' is unknown", item=number)
            if len(self.items) > MAX_ITEMS:
                raise MissionFileError(self.file, f"it has more than {MAX_ITEMS} items")

    def _read_complex(self, tree: dict[str, Any], number: int) -> None:
        kind = str(tree.get("complexItemType"))[:40]
        name = PATTERNS.get(kind, kind)
        try:
            trees = pattern_items(tree)
            self.areas += pattern_area(tree)
        except (ValueError, msgspec.ValidationError) as error:
            raise MissionFileError(self.file, f"{name}: {error}", item=number) from None
        for each in trees:
            self.items.append((self._simple(each, len(self.items) + 1), f"{name} {number}"))

    def _simple(self, tree: Any, number: int) -> SimpleItem:
        try:
            return msgspec.convert(tree, SimpleItem)
        except msgspec.ValidationError as error:
            raise MissionFileError(self.file, str(error), item=number) from None

    def numbered(self) -> Iterator[NumberedItem]:
        """The items; a jump leads to the number of its target, not to its id."""
        ids = {simple.do_jump_id: number for number, (simple, _) in enumerate(self.items, 1)}
        for number, (simple, part_of) in enumerate(self.items, 1):
            try:
                values = simple.numbers()
                if simple.command in _JUMPS and values[0] in ids:
                    values[0] = float(ids[int(values[0])])
                item = mission_item(simple.command, simple.frame, values)
            except ValueError as error:
                raise MissionFileError(self.file, str(error), item=number) from None
            yield NumberedItem(number, item, part_of)


def _home(file: str, values: Sequence[float | None] | None) -> Place | None:
    if not values or None in values[:2]:
        return None
    latitude, longitude, *altitudes = (math.nan if value is None else value for value in values)
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        raise MissionFileError(file, f"its home {latitude:g}, {longitude:g} is not a position in degrees")
    altitude = altitudes[0] if altitudes and math.isfinite(altitudes[0]) else 0.0
    return Place(latitude, longitude, altitude)


def _zones(file: str, fence: _Fence) -> Iterator[PlanZone]:
    if fence.version not in (1, 2):
        raise MissionFileError(file, f"its fence has version {fence.version}; lfield reads versions 1 and 2")
    polygons = [*fence.polygons, *([_PolygonZone(fence.polygon)] if fence.polygon else [])]
    for number, zone in enumerate(polygons, 1):
        where = f"polygon {number} of the fence"
        yield PlanZone(zone.inclusion, tuple(_place(file, where, corner) for corner in zone.polygon))
    for number, each in enumerate(fence.circles, 1):
        where = f"circle {number} of the fence"
        yield PlanZone(each.inclusion, (_place(file, where, each.circle.center),), each.circle.radius)


def _rally(file: str, rally: _Rally) -> Iterator[RallyPoint]:
    for number, values in enumerate(rally.points, 1):
        where = f"rally point {number}"
        latitude, longitude = _place(file, where, values)
        yield RallyPoint(latitude, longitude, values[2] if len(values) > 2 else 0.0)


def _place(file: str, where: str, values: Sequence[float | None]) -> tuple[float, float]:
    latitude, longitude = (*values, None, None)[:2]
    if latitude is None or longitude is None or abs(latitude) > 90.0 or abs(longitude) > 180.0:
        raise MissionFileError(file, f"{values} is not a position in degrees", where=where)
    return latitude, longitude
