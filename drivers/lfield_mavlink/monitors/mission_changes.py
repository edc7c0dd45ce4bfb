"""Whether the plans of a vehicle may be other than those that were checked, by what it tells. Pure.

Another station may upload a mission or rally points on a link that is not heard here. ArduPilot then tells
the number of items (MISSION_CURRENT, and PARAM_VALUE of its counters: ap-copter.g-mission), and says in AUTO
that it has begun an item again; PX4 begins with item 0, and newer versions tell ids of the plans
(MISSION_CURRENT of https://mavlink.io/en/messages/common.html). A change of as many items may show in nothing
but the place that it flies to: `MissionTarget` compares that with the limits.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection
from typing import Any

from lfield_mavlink.geo import Place

#: The parameters in which ArduPilot counts its items; those of a value that is told by name have this index.
COUNTERS, BY_NAME = frozenset({"MIS_TOTAL", "RALLY_TOTAL"}), 65535
#: What ArduPilot says in AUTO (mode_auto.cpp of ArduCopter and Rover 4.7).
CHANGED = "Auto mission changed"
#: Where the ids of mission, fence and rally points are in the payload of MISSION_CURRENT, and its length.
_IDS, _LENGTH = struct.Struct("<6xIII"), 18
_HEADER_1, _HEADER_2, _CHECKSUM = 6, 10, 2
#: Metres over ground and in height by which a target may be beyond a limit: roundings, and PX4's home, which
#: moves with GNSS (px4-copter.i-heights).
NEAR, LEVEL = 2.0, 3.0


class MissionChanges:
    """Signs of a change of the plans, from message to message."""

    def __init__(self) -> None:
        self._plans: tuple[int, ...] | None = None
        self._number = -1
        self._curved = False
        self._returns: Collection[int] = ()

    def checked(self, *, curved: bool = False, returns: Collection[int] = ()) -> None:
        """The plans were read and checked.

        `curved`: a path depends on where it begins; `returns`: the numbers of items that return, perhaps to
        rally points, which are looked at again before that.
        """
        self._curved, self._returns = curved, returns

    def on_current(self, message: Any) -> bool:
        """MISSION_CURRENT: whether it is a sign of another plan, or begins a curve from another place."""
        before, self._number = self._number, message.seq
        plans, self._plans = self._plans, (message.total, *_ids_of(message))
        depends = self._curved or message.seq + 1 in self._returns
        jumps = message.seq < before or (depends and message.seq != before)
        return jumps or (plans is not None and plans != self._plans)

    def on_parameter(self, message: Any) -> bool:
        """PARAM_VALUE: whether a counter was told unasked, or as anything is told by its name."""
        return message.param_id in COUNTERS and message.param_index == BY_NAME


def _ids_of(message: Any) -> tuple[int, int]:
    """The ids of the mission and the rally points; 0 where none are told."""
    packet = bytes(message.get_msgbuf())
    header = _HEADER_2 if packet[:1] == b"\xfd" else _HEADER_1
    payload = packet[header : header + packet[1]] if len(packet) > header + _CHECKSUM else b""
    mission, _, rally = _IDS.unpack(payload.ljust(_LENGTH, b"\0")[:_LENGTH])
    return mission, rally


class MissionTarget:
    """Where a vehicle in its mission flies to, against the limits: `radius` and `altitude` in metres."""

    def __init__(self, radius: float, altitude: float) -> None:
        self._radius, self._altitude = radius, altitude

    def beyond(self, message: Any, home: Place, *, flies: bool) -> str:
        """How POSITION_TARGET_GLOBAL_INT leads out of the limits, in words; '' when it does not.

        A rover has no heights; a place without a number is none.
        """
        place = Place.scaled(message.lat_int, message.lon_int, 0)
        if place is None or not (message.lat_int or message.lon_int):
            return ""
        north, east, _ = home.to(place)
        far, height = math.hypot(north, east), message.alt - home.altitude
        if far > self._radius + NEAR:
            return f"it flies to a place {far:.0f} m from home, beyond the limit of {self._radius:g} m"
        if flies and height > self._altitude + LEVEL:
            return f"it flies to a height of {height:.0f} m, above the limit of {self._altitude:g} m"
        return ""
