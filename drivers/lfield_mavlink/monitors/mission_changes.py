"""Detects changes of a vehicle's plans after they were checked. Pure.

Another station may upload a mission or rally points on a link that is not visible here. ArduPilot then
reports the number of items (MISSION_CURRENT, and PARAM_VALUE of its counters: ap-copter.g-mission), and in
AUTO that it has restarted an item; PX4 restarts with item 0, and newer versions report ids of the plans
(MISSION_CURRENT of https://mavlink.io/en/messages/common.html). A change with the same number of items may
show only in the target position: `MissionTarget` compares it with the limits.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection
from typing import Any

from lfield_mavlink.geodesy import Place

#: ArduPilot's counters of items; the index of a parameter value that was requested by name.
COUNTERS, BY_NAME = frozenset({"MIS_TOTAL", "RALLY_TOTAL"}), 65535
#: Text of ArduPilot in AUTO (mode_auto.cpp of ArduCopter and Rover 4.7).
CHANGED = "Auto mission changed"
#: Offset of the ids of mission, fence and rally points in MISSION_CURRENT, and its length.
_IDS, _LENGTH = struct.Struct("<6xIII"), 18
_HEADER_1, _HEADER_2, _CHECKSUM = 6, 10, 2
#: Metres horizontally and vertically by which a target may exceed a limit: rounding, and PX4's home, which
#: moves with GNSS (px4-copter.i-heights).
NEAR, LEVEL = 2.0, 3.0


class MissionChanges:
    """Detects changes of the plans from message to message."""

    def __init__(self) -> None:
        self._plans: tuple[int, ...] | None = None
        self._number = -1
        self._curved = False
        self._returns: Collection[int] = ()

    def on_checked(self, *, curved: bool = False, returns: Collection[int] = ()) -> None:
        """Records the plans that were read and checked.

        `curved`: the path depends on its starting point; `returns`: the numbers of items that return, perhaps
        to rally points, which are checked again before that.
        """
        self._curved, self._returns = curved, returns

    def on_current(self, message: Any) -> bool:
        """Whether MISSION_CURRENT indicates another plan, or a curve from another starting point."""
        previous, self._number = self._number, message.seq
        plans, self._plans = self._plans, (message.total, *_ids_of(message))
        depends_on_start = self._curved or message.seq + 1 in self._returns
        has_jumped = message.seq < previous or (depends_on_start and message.seq != previous)
        return has_jumped or (plans is not None and plans != self._plans)

    def on_parameter(self, message: Any) -> bool:
        """Whether PARAM_VALUE is a counter that was sent unrequested, or by name."""
        return message.param_id in COUNTERS and message.param_index == BY_NAME


def _ids_of(message: Any) -> tuple[int, int]:
    """The ids of the mission and the rally points; 0 without ids."""
    packet = bytes(message.get_msgbuf())
    header = _HEADER_2 if packet[:1] == b"\xfd" else _HEADER_1
    payload = packet[header : header + packet[1]] if len(packet) > header + _CHECKSUM else b""
    mission, _, rally = _IDS.unpack(payload.ljust(_LENGTH, b"\0")[:_LENGTH])
    return mission, rally


class MissionTarget:
    """Compares the target of a vehicle in its mission with the limits `radius` and `altitude` in metres."""

    def __init__(self, radius: float, altitude: float) -> None:
        self._radius, self._altitude = radius, altitude

    def excess(self, message: Any, home: Place, *, flies: bool) -> str:
        """The excess of POSITION_TARGET_GLOBAL_INT over the limits in words; '' within them.

        A rover has no heights; a position that is not finite is ignored.
        """
        place = Place.scaled(message.lat_int, message.lon_int, 0)
        if place is None or not (message.lat_int or message.lon_int):
            return ""
        north, east, _ = home.vector_to(place)
        distance, height = math.hypot(north, east), message.alt - home.altitude
        if distance > self._radius + NEAR:
            return (
                f"it flies to a position {distance:.0f} m from home, beyond the limit of {self._radius:g} m"
            )
        if flies and height > self._altitude + LEVEL:
            return f"it flies to a height of {height:.0f} m, above the limit of {self._altitude:g} m"
        return ""
