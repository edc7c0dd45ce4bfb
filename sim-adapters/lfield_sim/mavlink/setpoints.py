"""Converts setpoint messages to goals.

SET_POSITION_TARGET_LOCAL_NED 84, SET_POSITION_TARGET_GLOBAL_INT 86, SET_ATTITUDE_TARGET 82.
"""

from __future__ import annotations

import math
from typing import Any

from lfield_sim.autopilot.autopilot import Autopilot, Setpoint
from lfield_sim.autopilot.body.goals import ZERO, Goal, Keep, Lean, Reach, Track, Vector
from lfield_sim.autopilot.flavours import SetpointControl
from lfield_sim.autopilot.wind import GRAVITY
from lfield_sim.mavlink.geo import ABOVE_HOME, GeoOrigin, angles, is_near, turned

# type_mask bits of a position target: set means "ignore".
IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ACCELERATION = 0x7, 0x38, 0x1C0
IGNORE_YAW, IGNORE_YAW_RATE = 0x400, 0x800
# ... of an attitude target.
IGNORE_BODY_YAW_RATE, IGNORE_THRUST, IGNORE_ATTITUDE = 0x4, 0x40, 0x80
# MAV_FRAMEs of local targets; BODY_NED has velocities by the nose and offsets from here, as has BODY_FRD.
LOCAL, LOCAL_OFFSET, BODY, BODY_OFFSET, BODY_FRD = 1, 7, 8, 9, 12
LOCAL_FRAMES = frozenset({LOCAL, LOCAL_OFFSET, BODY, BODY_OFFSET, BODY_FRD})
#: Maximum lean in rad, and climb at full thrust in m/s (half thrust holds the height).
STEEPEST, CLIMB = math.radians(45.0), 2.5


def local_target(pilot: Autopilot, message: Any) -> Setpoint | None:
    """The setpoint of message 84; None if invalid."""
    frame, vehicle = message.coordinate_frame, pilot.vehicle
    if frame not in LOCAL_FRAMES:
        return None
    place: Vector = (message.x, message.y, message.z)
    velocity: Vector = (message.vx, message.vy, message.vz)
    lean: Vector = (message.afx, message.afy, 0.0)
    if frame in (BODY, BODY_OFFSET, BODY_FRD):
        place, velocity, lean = (turned(each, vehicle.yaw) for each in (place, velocity, lean))
    if frame != LOCAL:
        place = (place[0] + vehicle.place[0], place[1] + vehicle.place[1], place[2] + vehicle.place[2])
    return _setpoint(pilot, message, place, velocity, lean)


def global_target(pilot: Autopilot, origin: GeoOrigin, message: Any) -> Setpoint | None:
    """The setpoint of message 86; None if invalid."""
    north, east = origin.local(message.lat_int, message.lon_int)
    top = pilot.home[2] if message.coordinate_frame in ABOVE_HOME else origin.altitude
    velocity = (message.vx, message.vy, message.vz)
    lean = (message.afx, message.afy, 0.0)
    return _setpoint(pilot, message, (north, east, top - message.alt), velocity, lean)


def attitude_target(message: Any) -> Setpoint | None:
    """The setpoint of message 82: a lean is an acceleration, thrust above a half climbs."""
    values = (*message.q, message.thrust, message.body_yaw_rate)
    if not all(map(math.isfinite, values)):
        return None
    mask = message.type_mask
    goal, yaw = None, None
    if not mask & IGNORE_ATTITUDE and math.hypot(*message.q) > 1e-3:
        roll, pitch, yaw = angles(*(part / math.hypot(*message.q) for part in message.q))
        thrust = 0.5 if mask & IGNORE_THRUST else min(max(message.thrust, 0.0), 1.0)
        forward, right = -math.tan(_lean(pitch)) * GRAVITY, math.tan(_lean(roll)) * GRAVITY
        north, east, _ = turned((forward, right, 0.0), yaw)
        goal = Lean(north, east, (0.5 - thrust) * 2.0 * CLIMB)
    rate = None if mask & IGNORE_BODY_YAW_RATE else message.body_yaw_rate
    return Setpoint(goal, yaw, rate)


def _setpoint(
    pilot: Autopilot, message: Any, place: Vector, velocity: Vector, lean: Vector
) -> Setpoint | None:
    mask = message.type_mask
    goal: Goal | None = None
    control = SetpointControl.VELOCITY
    if not mask & IGNORE_POSITION:
        goal = _place(pilot, place, ZERO if mask & IGNORE_VELOCITY else velocity)
        control = SetpointControl.PLACE if mask & IGNORE_VELOCITY else SetpointControl.BOTH
    elif not mask & IGNORE_VELOCITY:
        goal = Keep(velocity) if is_near(velocity) else None
    elif not mask & IGNORE_ACCELERATION:
        goal = Lean(*lean) if is_near(lean) else None
    yaw = None if mask & IGNORE_YAW or not math.isfinite(message.yaw) else message.yaw
    rate = None if mask & IGNORE_YAW_RATE or not math.isfinite(message.yaw_rate) else message.yaw_rate
    # A heading has priority over a rate.
    setpoint = Setpoint(goal, yaw, None if yaw is not None else rate, control)
    return None if setpoint == Setpoint() else setpoint


def _place(pilot: Autopilot, place: Vector, velocity: Vector) -> Goal | None:
    """A position as a goal: a PX4 copter follows it without shaping."""
    if not (is_near(place) and is_near(velocity)):
        return None
    return Track(place, velocity) if pilot.flavour.needs_stream and pilot.flies else Reach(place)


def _lean(angle: float) -> float:
    return max(-STEEPEST, min(STEEPEST, angle))
