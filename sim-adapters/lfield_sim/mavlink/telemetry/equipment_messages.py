"""Messages about payload: servos, relays, winch, camera, gimbal."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.equipment.gimbal import PITCH_RANGE, YAW_RANGE
from lfield_sim.autopilot.equipment.payload import MAVLINK_GIMBAL
from lfield_sim.mavlink.geo import GeoOrigin, quaternion
from lfield_sim.mavlink.telemetry.motion_messages import micros, millis

#: A gimbal with pitch and yaw, which follow the vehicle or stay.
GIMBAL_ABILITIES = (
    dialect.GIMBAL_DEVICE_CAP_FLAGS_HAS_PITCH_AXIS
    | dialect.GIMBAL_DEVICE_CAP_FLAGS_HAS_PITCH_LOCK
    | dialect.GIMBAL_DEVICE_CAP_FLAGS_HAS_YAW_AXIS
    | dialect.GIMBAL_DEVICE_CAP_FLAGS_HAS_YAW_FOLLOW
    | dialect.GIMBAL_DEVICE_CAP_FLAGS_HAS_YAW_LOCK
)
#: A further ability of the manager: to point at a place.
POINTS_AT_PLACE = dialect.GIMBAL_MANAGER_CAP_FLAGS_CAN_POINT_LOCATION_GLOBAL
WINCH_HEALTHY = 1


def servo_output_raw(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """SERVO_OUTPUT_RAW 36, in microseconds."""
    servos = list(autopilot.payload.servos.values())
    return dialect.MAVLink_servo_output_raw_message(
        micros(autopilot) & 0xFFFFFFFF, 0, *servos[:8], *servos[8:]
    )


def relay_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """RELAY_STATUS 376."""
    relays = autopilot.payload.relays
    states = sum(1 << number for number, state in relays.items() if state)
    return dialect.MAVLink_relay_status_message(millis(autopilot), states, (1 << len(relays)) - 1)


def winch_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """WINCH_STATUS 9005."""
    payload = autopilot.payload
    moving = payload.line != payload.line_goal
    speed = math.copysign(payload.line_speed, payload.line_goal - payload.line) if moving else 0.0
    return dialect.MAVLink_winch_status_message(
        micros(autopilot), payload.line, speed, math.nan, 12.0, 1.0 if moving else 0.0, 25, WINCH_HEALTHY
    )


def device_of(autopilot: Autopilot) -> int:
    """The gimbal's id: 1 on the outputs of the autopilot, with MAVLink its component id."""
    return int(dialect.MAV_COMP_ID_GIMBAL) if MAVLINK_GIMBAL in autopilot.payload.fitted else 1


def mount_status(autopilot: Autopilot) -> Any:
    """MOUNT_STATUS 158, in hundredths of a degree."""
    gimbal = autopilot.payload.gimbal
    pitch, yaw = (round(math.degrees(angle) * 100) for angle in (gimbal.pitch, gimbal.yaw))
    return dialect.MAVLink_mount_status_message(0, 0, pitch, 0, yaw, dialect.MAV_MOUNT_MODE_MAVLINK_TARGETING)


def gimbal_manager_information(autopilot: Autopilot) -> Any:
    """GIMBAL_MANAGER_INFORMATION 280."""
    abilities, device = GIMBAL_ABILITIES | POINTS_AT_PLACE, device_of(autopilot)
    return dialect.MAVLink_gimbal_manager_information_message(
        millis(autopilot), abilities, device, 0.0, 0.0, *PITCH_RANGE, *YAW_RANGE
    )


def gimbal_manager_status(autopilot: Autopilot) -> Any:
    """GIMBAL_MANAGER_STATUS 281: the controllers."""
    gimbal, device = autopilot.payload.gimbal, device_of(autopilot)
    return dialect.MAVLink_gimbal_manager_status_message(
        millis(autopilot), _gimbal_flags(autopilot), device, *gimbal.primary, *gimbal.secondary
    )


def gimbal_device_information(autopilot: Autopilot, device: int) -> Any:
    """GIMBAL_DEVICE_INFORMATION 283."""
    return dialect.MAVLink_gimbal_device_information_message(
        millis(autopilot), b"lfield", b"simulated gimbal", b"", 1, 1, 1, GIMBAL_ABILITIES, 0, 0.0, 0.0,
        *PITCH_RANGE, *YAW_RANGE, device,
    )  # fmt: skip


def gimbal_device_attitude_status(autopilot: Autopilot, device: int) -> Any:
    """GIMBAL_DEVICE_ATTITUDE_STATUS 285: yaw relative to the nose, or to north while that is locked."""
    gimbal, yaw = autopilot.payload.gimbal, autopilot.payload.gimbal.yaw
    if gimbal.is_locked:
        yaw += autopilot.vehicle.yaw
    return dialect.MAVLink_gimbal_device_attitude_status_message(
        0, 0, millis(autopilot), _gimbal_flags(autopilot), quaternion(0.0, gimbal.pitch, yaw),
        0.0, 0.0, 0.0, 0, math.nan, math.nan, device,
    )  # fmt: skip


def _gimbal_flags(autopilot: Autopilot) -> int:
    level = dialect.GIMBAL_DEVICE_FLAGS_ROLL_LOCK | dialect.GIMBAL_DEVICE_FLAGS_PITCH_LOCK
    if autopilot.payload.gimbal.is_locked:
        return int(
            level | dialect.GIMBAL_DEVICE_FLAGS_YAW_LOCK | dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
        )
    return int(level | dialect.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME)


def camera_feedback(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """CAMERA_FEEDBACK 180: ArduPilot's message for a picture."""
    north, east, down = autopilot.vehicle.place
    roll, pitch, yaw = (
        math.degrees(a) for a in (autopilot.vehicle.roll, autopilot.vehicle.pitch, autopilot.vehicle.yaw)
    )
    height = place.altitude - down
    camera = autopilot.payload.camera
    count = (camera.pictures + camera.is_shooting) & 0xFFFF
    return dialect.MAVLink_camera_feedback_message(
        micros(autopilot), 0, 0, count, *place.at(north, east), height, -down, roll, pitch, yaw, 0.0, 0, count
    )
