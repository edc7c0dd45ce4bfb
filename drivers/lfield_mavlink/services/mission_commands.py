"""Tables of mission commands: flown, with a position, jumps, curves.

https://mavlink.io/en/messages/common.html#mav_commands.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.plan_items import Item

#: Commands that take off, and those that may precede them in a mission that starts on the ground.
TAKEOFFS = frozenset(
    {
        dialect.MAV_CMD_NAV_TAKEOFF,
        dialect.MAV_CMD_NAV_VTOL_TAKEOFF,
        dialect.MAV_CMD_NAV_TAKEOFF_LOCAL,
    }
)
#: Commands below this number are flown (NAV), except `_NOT_FLOWN`; later ones are executed in parallel.
_LAST_FLOWN = dialect.MAV_CMD_NAV_LAST
_NOT_FLOWN = frozenset(
    {
        dialect.MAV_CMD_NAV_ROI,
        dialect.MAV_CMD_NAV_DELAY,
        dialect.MAV_CMD_DO_FOLLOW,
        dialect.MAV_CMD_DO_FOLLOW_REPOSITION,
        dialect.MAV_CMD_DO_ORBIT,
        dialect.MAV_CMD_DO_FIGURE_EIGHT,
    }
)
#: Commands above `_LAST_FLOWN` that are flown.
_FLOWN = frozenset(
    {
        dialect.MAV_CMD_NAV_SET_YAW_SPEED,
        dialect.MAV_CMD_NAV_SCRIPT_TIME,
        dialect.MAV_CMD_NAV_ATTITUDE_TIME,
    }
)

#: Commands with a position.
PLACED = frozenset(
    {
        dialect.MAV_CMD_NAV_WAYPOINT,
        dialect.MAV_CMD_NAV_LOITER_UNLIM,
        dialect.MAV_CMD_NAV_LOITER_TURNS,
        dialect.MAV_CMD_NAV_LOITER_TIME,
        dialect.MAV_CMD_NAV_LOITER_TO_ALT,
        dialect.MAV_CMD_NAV_LAND,
        dialect.MAV_CMD_NAV_VTOL_LAND,
        dialect.MAV_CMD_NAV_TAKEOFF,
        dialect.MAV_CMD_NAV_VTOL_TAKEOFF,
        dialect.MAV_CMD_NAV_PAYLOAD_PLACE,
        dialect.MAV_CMD_NAV_SPLINE_WAYPOINT,
        dialect.MAV_CMD_NAV_ARC_WAYPOINT,
        dialect.MAV_CMD_DO_ORBIT,
        dialect.MAV_CMD_DO_REPOSITION,
    }
)
#: Commands that change the current item.
JUMPS = (
    dialect.MAV_CMD_DO_JUMP,
    dialect.MAV_CMD_DO_JUMP_TAG,
    dialect.MAV_CMD_DO_SET_MISSION_CURRENT,
)

#: Commands that land.
LANDINGS = (dialect.MAV_CMD_NAV_LAND, dialect.MAV_CMD_NAV_VTOL_LAND)

#: Commands with a curved path from the previous position.
CURVES = (dialect.MAV_CMD_NAV_SPLINE_WAYPOINT, dialect.MAV_CMD_NAV_ARC_WAYPOINT)


def starts_with_takeoff(items: Sequence[Item]) -> bool:
    """Whether the first flown item is a takeoff: cameras, speeds and delays may precede it."""
    flown = next((item.command for item in items if is_flown(item.command)), None)
    return flown in TAKEOFFS


def is_flown(command: int) -> bool:
    """Whether a command is flown, as opposed to executed at once."""
    return (command < _LAST_FLOWN and command not in _NOT_FLOWN) or command in _FLOWN


def has_command(items: Sequence[Item], *commands: int) -> bool:
    """Whether one of the items has one of these commands."""
    return any(item.command in commands for item in items)
