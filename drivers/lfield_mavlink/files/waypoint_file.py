"""Reads `QGC WPL` text files (`.waypoints`, `.txt`) of Mission Planner, MAVProxy and QGroundControl.

https://mavlink.io/en/file_formats/. Version 110 begins with home in row 0; version 120, of old versions of
QGroundControl, has no home. Fences and rally points are files of the same format with other commands.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.driver import MissionFileError, ascii_number, utf8_bytes
from lfield_mavlink.files.plan_file import MAX_ITEMS, NumberedItem, PlanFile, mission_item, zones_and_points
from lfield_mavlink.geodesy import Place
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.plan_items import CIRCLES, POLYGONS, RALLY_POINT, WAYPOINT

HEAD = "QGC WPL"
_FIELDS = 12
#: Commands of row 0 if it is home; some programs write 0.
_HOMES = (0, WAYPOINT)
_OTHER_PLANS = frozenset({*CIRCLES, *POLYGONS, RALLY_POINT, dialect.MAV_CMD_NAV_FENCE_RETURN_POINT})


def read_waypoints(file: str, data: bytes) -> PlanFile:
    """The content of a `QGC WPL` file. Raises MissionFileError."""
    lines = utf8_bytes(file, data).decode().splitlines()
    version = _version(file, lines[0] if lines else "")
    rows = _rows(file, lines)
    home = None
    if version == 110 and rows and rows[0].number == 0 and rows[0].item.command in _HOMES:
        row = rows.pop(0).item
        # Mission Planner and MAVProxy write 0, 0 while home is unknown.
        home = Place(row.x / 1e7, row.y / 1e7, row.z) if row.x or row.y else None
    zones, points = zones_and_points(file, rows)
    items = tuple(row for row in rows if row.item.command not in _OTHER_PLANS)
    return PlanFile(file, items, home, tuple(zones), tuple(points))


def _version(file: str, line: str) -> int:
    fields = line.split()
    if fields[:2] != HEAD.split() or len(fields) != 3:
        raise MissionFileError(file, f"its first line is not '{HEAD} 110'", where="line 1")
    if fields[2] not in ("110", "120"):
        reason = f"version {fields[2][:10]} is not read; open the file in Mission Planner, and save it"
        raise MissionFileError(file, reason, where="line 1")
    return int(fields[2])


def _rows(file: str, lines: Sequence[str]) -> list[NumberedItem]:
    rows: list[NumberedItem] = []
    for number, line in enumerate(lines[1:], 2):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        if len(rows) > MAX_ITEMS:
            raise MissionFileError(file, f"it has more than {MAX_ITEMS} items")
        try:
            row = _row(fields)
        except ValueError as error:
            raise MissionFileError(file, str(error), where=f"line {number}") from None
        if rows and row.number != rows[-1].number + 1:
            reason = f"item {row.number} follows item {rows[-1].number}"
            raise MissionFileError(file, reason, where=f"line {number}")
        rows.append(row)
    return rows


def _row(fields: Sequence[str]) -> NumberedItem:
    """Index, current, frame, command, seven parameters, autocontinue. Raises ValueError."""
    if len(fields) != _FIELDS:
        raise ValueError(f"it has {len(fields)} fields instead of {_FIELDS}")
    try:
        index, _, frame, command = (_integer(text) for text in fields[:4])
        values = [ascii_number(text) for text in fields[4:11]]
    except (ValueError, OverflowError):
        raise ValueError(f"'{' '.join(fields)[:80]}' has a field that is not a number") from None
    return NumberedItem(index, mission_item(command, frame, values))


def _integer(text: str) -> int:
    value = ascii_number(text)
    if value != int(value):
        raise ValueError
    return int(value)
