"""Where an autopilot is going, as it tells: POSITION_TARGET_LOCAL_NED 85 and POSITION_TARGET_GLOBAL_INT 87.

ArduPilot tells the goal of GUIDED, of a mission and of a return as 87, wherever that came from
(ap-rover.g-mission, ap-rover.h-rover; `ModeAuto::get_wp` of ArduCopter 4.7), and nothing where it follows no
place; a copter tells its setpoint as 85 in GUIDED (`ModeGuided::get_wp` and
`send_position_target_local_ned` of ArduCopter 4.7). PX4 tells the goal of a mode of its own as 87, and its
setpoint as 85, which are no numbers while it follows none (ap-rover.c-speed, px4-copter.c-speed,
px4-copter.d-velocity).

So a driver can see that another station has sent it elsewhere: an ArduCopter follows the last setpoint,
whoever sent it.
"""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.body.goals import ZERO, Keep, Lean, Reach, Rest, Track, Vector
from lfield_sim.autopilot.flavours import Role
from lfield_sim.mavlink.geo import Place
from lfield_sim.mavlink.telemetry.motion import millis

#: type_mask: nothing counts but the position, and nothing but acceleration and heading.
ONLY_POSITION, NO_SETPOINT = 0xFDF8, 0x3F
#: type_mask of an ArduCopter's setpoint: a place, or a velocity.
BY_PLACE, BY_VELOCITY = 0x0DF8, 0x0C07
#: What PX4 tells while it follows no place or no velocity.
NOWHERE: Vector = (math.nan, math.nan, math.nan)


def goal_of(autopilot: Autopilot) -> Vector | None:
    """The place in the local frame that it goes to and would tell; None where it tells none."""
    goal, px4 = autopilot.vehicle.goal, autopilot.flavour.needs_stream
    guided = autopilot.role is Role.GUIDED
    silent = not autopilot.armed or not isinstance(goal, Reach) or goal is autopilot.risen_to
    if silent or not isinstance(goal, Reach) or (guided and px4):
        return None
    # Of a curve it tells the end.
    curve = autopilot.mission.curve if autopilot.role is Role.MISSION else []
    return curve[-1] if curve else goal.place


def distance_of(autopilot: Autopilot) -> int:
    """Whole metres over ground to the place that it tells, 0 for none (ap-rover.f-fence-breach)."""
    goal = goal_of(autopilot)
    return 0 if goal is None else min(65535, int(math.dist(goal[:2], autopilot.vehicle.place[:2])))


def tells_setpoint(autopilot: Autopilot) -> bool:
    """Whether it tells its setpoint now: PX4 always, an ArduCopter in GUIDED but for an attitude."""
    if autopilot.flavour.needs_stream:
        return True
    follows = not isinstance(autopilot.vehicle.goal, Lean)
    return autopilot.flies and autopilot.role is Role.GUIDED and follows


def position_target_global_int(autopilot: Autopilot, place: Place) -> Any:
    """POSITION_TARGET_GLOBAL_INT 87, with a height above mean sea level."""
    north, east, down = goal_of(autopilot) or autopilot.vehicle.place
    mask, frame = (0, 5) if autopilot.flavour.needs_stream else (ONLY_POSITION, 0)
    return dialect.MAVLink_position_target_global_int_message(
        millis(autopilot), frame, mask, *place.at(north, east), place.altitude - down, *[0.0] * 8
    )


def position_target_local_ned(autopilot: Autopilot, _: Place) -> Any:
    """POSITION_TARGET_LOCAL_NED 85: the setpoint that its control follows now."""
    position, velocity, mask = NOWHERE, NOWHERE, NO_SETPOINT
    if not autopilot.flavour.needs_stream:
        return _ardupilot_setpoint(autopilot)
    match autopilot.vehicle.goal:
        case Track(place, speed):
            position, velocity, mask = place, speed, 0
        case Reach():
            # Its own trajectory, a little ahead of it.
            position, velocity, mask = autopilot.vehicle.place, autopilot.vehicle.velocity, 0
        case Keep(speed):
            velocity, mask = speed, 0x7
    return dialect.MAVLink_position_target_local_ned_message(
        millis(autopilot), 1, mask, *position, *velocity, *[0.0] * 5
    )


def _ardupilot_setpoint(autopilot: Autopilot) -> Any:
    """A copter that has entered GUIDED, or whose velocity is over, is told a velocity of nothing."""
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
