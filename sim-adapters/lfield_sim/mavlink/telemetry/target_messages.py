"""Reported targets of an autopilot: POSITION_TARGET_LOCAL_NED 85 and POSITION_TARGET_GLOBAL_INT 87.

ArduPilot reports the goal of GUIDED, of a mission and of a return as 87, from any source
(ap-rover.g-mission, ap-rover.h-rover; `ModeAuto::get_wp` of ArduCopter 4.7), and nothing without a target
position; a copter reports its setpoint as 85 in GUIDED (`ModeGuided::get_wp` and
`send_position_target_local_ned` of ArduCopter 4.7). PX4 reports the goal of an automatic mode as 87, and its
setpoint as 85, with NaN without one (ap-rover.c-speed, px4-copter.c-speed, px4-copter.d-velocity).

So a driver can detect that another station has sent the vehicle elsewhere: an ArduCopter follows the last
setpoint of any sender.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.body.goals import ZERO, Keep, Lean, Reach, Rest, Track, Vector
from lfield_sim.autopilot.flavours import Role
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.telemetry.motion_messages import millis

#: type_mask: only the position; only acceleration and heading.
ONLY_POSITION, NO_SETPOINT = 0xFDF8, 0x3F
#: type_mask of an ArduCopter's setpoint: a position, or a velocity.
BY_PLACE, BY_VELOCITY = 0x0DF8, 0x0C07
#: PX4's value without a position or velocity.
UNDEFINED: Vector = (math.nan, math.nan, math.nan)


def goal_of(autopilot: Autopilot) -> Vector | None:
    """The reported goal in the local frame; None without one."""
    goal, px4 = autopilot.vehicle.goal, autopilot.flavour.needs_stream
    guided = autopilot.role is Role.GUIDED
    silent = not autopilot.armed or not isinstance(goal, Reach) or goal is autopilot.risen_to
    if silent or not isinstance(goal, Reach) or (guided and px4):
        return None
    # For a curve, the end is reported.
    curve = autopilot.mission.curve if autopilot.role is Role.MISSION else []
    return curve[-1] if curve else goal.place


def distance_of(autopilot: Autopilot) -> int:
    """Horizontal distance to the reported goal in whole metres, 0 for none (ap-rover.f-fence-breach)."""
    goal = goal_of(autopilot)
    return 0 if goal is None else min(65535, int(math.dist(goal[:2], autopilot.vehicle.place[:2])))


def sends_setpoint(autopilot: Autopilot) -> bool:
    """Whether the autopilot reports its setpoint now: PX4 always, an ArduCopter in GUIDED except for an
    attitude.
    """
    if autopilot.flavour.needs_stream:
        return True
    follows = not isinstance(autopilot.vehicle.goal, Lean)
    return autopilot.flies and autopilot.role is Role.GUIDED and follows


def position_target_global_int(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """POSITION_TARGET_GLOBAL_INT 87, with a height above mean sea level."""
    north, east, down = goal_of(autopilot) or autopilot.vehicle.place
    mask, frame = (0, 5) if autopilot.flavour.needs_stream else (ONLY_POSITION, 0)
    return dialect.MAVLink_position_target_global_int_message(
        millis(autopilot), frame, mask, *place.at(north, east), place.altitude - down, *[0.0] * 8
    )


def position_target_local_ned(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """POSITION_TARGET_LOCAL_NED 85: the present setpoint."""
    position, velocity, mask = UNDEFINED, UNDEFINED, NO_SETPOINT
    if not autopilot.flavour.needs_stream:
        return _ardupilot_setpoint(autopilot)
    match autopilot.vehicle.goal:
        case Track(place, speed):
            position, velocity, mask = place, speed, 0
        case Reach():
            # The autopilot's own trajectory, slightly ahead of the vehicle.
            position, velocity, mask = autopilot.vehicle.place, autopilot.vehicle.velocity, 0
        case Keep(speed):
            velocity, mask = speed, 0x7
    return dialect.MAVLink_position_target_local_ned_message(
        millis(autopilot), 1, mask, *position, *velocity, *[0.0] * 5
    )


def _ardupilot_setpoint(autopilot: Autopilot) -> Any:
    """A copter that has entered GUIDED, or whose velocity has expired, reports a velocity of zero."""
    position, velocity, mask = ZERO, ZERO, BY_VELOCITY
    match autopilot.vehicle.goal:
        case Keep(speed):
            velocity = speed
        case Reach(place):
            position, mask = place, BY_PLACE
        case Rest():
            mask = BY_VELOCITY if autopilot.lifts_at is None else BY_PLACE
        case _:
            mask = BY_PLACE
    return dialect.MAVLink_position_target_local_ned_message(
        millis(autopilot), 1, mask, *position, *velocity, *[0.0] * 5
    )
