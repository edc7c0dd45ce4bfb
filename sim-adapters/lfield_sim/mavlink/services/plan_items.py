"""One item of a plan (mission, fence or rally points): decoding, encoding, and checks.

Mission protocol: https://mavlink.io/en/services/mission.html.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

from msgspec import Struct
from pymavlink.dialects.v20 import all as dialect


class PlanType(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


class PlanResult(IntEnum):
    """The used values of MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM3 = 8
    INVALID_PARAM4 = 9
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


#: Global frames: above sea level, above home, above terrain; each with its INT twin.
ABOVE_SEA, ABOVE_HOME, ABOVE_TERRAIN = frozenset({0, 5}), frozenset({3, 6}), frozenset({10, 11})
PLACED = ABOVE_SEA | ABOVE_HOME | ABOVE_TERRAIN
#: MAV_FRAME_MISSION: a command without a position.
UNPLACED = 2

WAYPOINT, TAKEOFF, VTOL_TAKEOFF = 16, 22, 84
#: Commands with a position of both autopilots: waypoint, loiter (unlimited, for a time, to a height), land,
#: takeoff, and VTOL landing and takeoff.
BOTH_PLACES = frozenset({WAYPOINT, 17, 19, 21, TAKEOFF, 31, VTOL_TAKEOFF, 85})
#: The same of ArduPilot only: turns, change of height, arc, spline, payload placement.
ARDUPILOT_PLACES = BOTH_PLACES | {18, 30, 36, 82, 94}
PLACE_COMMANDS = ARDUPILOT_PLACES
#: Immediate or delaying commands of both: return, delays, distance; jump, speed, home, region of interest,
#: camera, gimbal, gripper, winch, landing mark.
_BOTH = frozenset(
    {20, 93, 112, 114, 177, 178, 179, 189, 195, 197, 201, 203, 205, 206, 211, 212, 530, 532, 534, 1000}
    | {2000, 2001, 2500, 2501, 42600}
)
#: Of ArduPilot only: yaw, relays, servos, fence, parachute, inverted flight, direction, guided flight and its
#: limits, engine, sprayer, scripts, switches, jump tags.
_ARDUPILOT = frozenset(
    {92, 115, 181, 182, 183, 184, 188, 194, 202, 207, 208, 210, 213, 215, 216, 217, 218, 222, 223, 531}
    | {600, 601, 42702, 42703}
)
#: Of PX4 only: outputs, triggers, transitions, the gate, arming.
_PX4 = frozenset({80, 187, 196, 200, 204, 214, 260, 400, 1001, 2003, 3000, 4501})
RALLY = 5100
FENCE_RETURN, POLYGON_IN, POLYGON_OUT, CIRCLE_IN, CIRCLE_OUT = 5000, 5001, 5002, 5003, 5004
POLYGONS, CIRCLES = frozenset({POLYGON_IN, POLYGON_OUT}), frozenset({CIRCLE_IN, CIRCLE_OUT})
#: Mission commands accepted by ArduPilot, and PX4.
ARDUPILOT_COMMANDS = ARDUPILOT_PLACES | _BOTH | _ARDUPILOT
PX4_COMMANDS = BOTH_PLACES | _BOTH | _PX4
COMMANDS = {
    PlanType.FENCE: POLYGONS | CIRCLES | {FENCE_RETURN},
    PlanType.RALLY: frozenset({RALLY}),
}
_PARAMS = (
    PlanResult.INVALID_PARAM1,
    PlanResult.INVALID_PARAM2,
    PlanResult.INVALID_PARAM3,
    PlanResult.INVALID_PARAM4,
)


class PlanItem(Struct, frozen=True):
    """One item: `values` are param1 to param4, `x` and `y` 1e-7 degrees, `z` metres in its frame."""

    command: int
    frame: int
    values: tuple[float, float, float, float]
    x: int = 0
    y: int = 0
    z: float = 0.0
    autocontinue: int = 1

    @classmethod
    def read(cls, message: Any) -> PlanItem:
        """The item in MISSION_ITEM_INT 73, or in the old MISSION_ITEM 39 with float degrees."""
        x, y = message.x, message.y
        if message.get_msgId() == dialect.MAVLINK_MSG_ID_MISSION_ITEM:
            x, y = _tenths_of_micro(x), _tenths_of_micro(y)
        values = (message.param1, message.param2, message.param3, message.param4)
        return cls(message.command, message.frame, values, x, y, message.z, message.autocontinue)

    def write(
        self, peer: tuple[int, int], number: int, kind: PlanType, *, current: bool, whole: bool = True
    ) -> Any:
        """The item as MISSION_ITEM_INT, or as MISSION_ITEM unless `whole`."""
        head = (*peer, number, self.frame, self.command, int(current), self.autocontinue, *self.values)
        if whole:
            return dialect.MAVLink_mission_item_int_message(*head, self.x, self.y, self.z, int(kind))
        return dialect.MAVLink_mission_item_message(*head, self.x / 1e7, self.y / 1e7, self.z, int(kind))

    @property
    def degrees(self) -> tuple[float, float]:
        """Latitude and longitude."""
        return self.x / 1e7, self.y / 1e7


def check(item: PlanItem, kind: PlanType, *, nan_means_unset: bool) -> PlanResult:
    """Whether an autopilot accepts an item. PX4 uses NaN for "not given"; ArduPilot only for a waypoint's
    yaw.
    """
    missions = PX4_COMMANDS if nan_means_unset else ARDUPILOT_COMMANDS
    if item.command not in COMMANDS.get(kind, missions):
        return PlanResult.UNSUPPORTED
    if item.frame not in PLACED and (item.frame != UNPLACED or _has_place(item, kind)):
        return PlanResult.UNSUPPORTED_FRAME
    for number, (value, invalid) in enumerate(zip(item.values, _PARAMS, strict=True), 1):
        may_be_nan = nan_means_unset or (number == 4 and item.command in PLACE_COMMANDS)
        if math.isinf(value) or (math.isnan(value) and not may_be_nan):
            return invalid
    if _has_place(item, kind):
        return _check_place(item)
    return PlanResult.ACCEPTED


def check_fence(items: Sequence[PlanItem]) -> PlanResult:
    """Whether all vertices of each polygon are present, at least three, and circles have a radius."""
    remaining, polygon = 0, (0, 0.0)
    for item in items:
        if item.command in POLYGONS:
            corner = (item.command, item.values[0])
            if remaining == 0:
                polygon, remaining = corner, int(item.values[0]) if 3 <= item.values[0] <= 255 else 0
            if corner != polygon or remaining == 0:
                return PlanResult.INVALID_PARAM1
            remaining -= 1
        elif remaining or (item.command in CIRCLES and not item.values[0] > 0.0):
            return PlanResult.INVALID_PARAM1
    return PlanResult.INVALID if remaining else PlanResult.ACCEPTED


def is_too_small(item: PlanItem) -> bool:
    """Whether an item's polygon declares fewer than three corners."""
    return item.command in POLYGONS and not item.values[0] >= 3


def _has_place(item: PlanItem, kind: PlanType) -> bool:
    return kind is not PlanType.MISSION or item.command in PLACE_COMMANDS


def _check_place(item: PlanItem) -> PlanResult:
    latitude, longitude = item.degrees
    if abs(latitude) > 90.0:
        return PlanResult.INVALID_PARAM5_X
    if abs(longitude) > 180.0:
        return PlanResult.INVALID_PARAM6_Y
    return PlanResult.ACCEPTED if abs(item.z) < 1e6 else PlanResult.INVALID_PARAM7


def _tenths_of_micro(degrees: float) -> int:
    """Degrees as 1e-7 degrees; an invalid number becomes one that every check refuses."""
    return round(degrees * 1e7) if abs(degrees) <= 180.0 else 0x7FFFFFFF
