"""Messages about payload: servos, relays, winch, camera, gimbal."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.payload import PITCH_RANGE, YAW_RANGE
from lfield_sim.mavlink.geo import GeoOrigin, quaternion
from lfield_sim.mavlink.telemetry.motion_messages import micros, millis

#: The gimbal's number in the messages of the gimbal protocol.
GIMBAL = 1
GIMBAL_ABILITIES = 0x8 | 0x10 | 0x200 | 0x400
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
    on = sum(1 << number for number, state in relays.items() if state)
    return dialect.MAVLink_relay_status_message(millis(autopilot), on, (1 << len(relays)) - 1)


def winch_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """WINCH_STATUS 9005."""
    payload = autopilot.payload
    moving = payload.line != payload.line_goal
    speed = math.copysign(payload.line_speed, payload.line_goal - payload.line) if moving else 0.0
    return dialect.MAVLink_winch_status_message(
        micros(autopilot), payload.line, speed, math.nan, 12.0, 1.0 if moving else 0.0, 25, WINCH_HEALTHY
    )


def mount_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """MOUNT_STATUS 158, in hundredths of a degree."""
    payload = autopilot.payload
    pitch, yaw = (round(math.degrees(angle) * 100) for angle in (payload.pitch, payload.yaw))
    return dialect.MAVLink_mount_status_message(0, 0, pitch, 0, yaw, dialect.MAV_MOUNT_MODE_MAVLINK_TARGETING)


def gimbal_manager_information(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """GIMBAL_MANAGER_INFORMATION 280."""
    return dialect.MAVLink_gimbal_manager_information_message(
        millis(autopilot), GIMBAL_ABILITIES, GIMBAL, 0.0, 0.0, *PITCH_RANGE, *YAW_RANGE
    )


def gimbal_manager_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """GIMBAL_MANAGER_STATUS 281: no exclusive control."""
    return dialect.MAVLink_gimbal_manager_status_message(millis(autopilot), 0, GIMBAL, 0, 0, 0, 0)


def gimbal_device_attitude_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """GIMBAL_DEVICE_ATTITUDE_STATUS 285: yaw relative to the nose."""
    payload = autopilot.payload
    rotation = quaternion(0.0, payload.pitch, payload.yaw)
    return dialect.MAVLink_gimbal_device_attitude_status_message(
        0, 0, millis(autopilot), 0, rotation, 0.0, 0.0, 0.0, 0, math.nan, math.nan, GIMBAL
    )


def camera_feedback(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """CAMERA_FEEDBACK 180: ArduPilot's message for a picture."""
    north, east, down = autopilot.vehicle.place
    roll, pitch, yaw = (
        math.degrees(a) for a in (autopilot.vehicle.roll, autopilot.vehicle.pitch, autopilot.vehicle.yaw)
    )
    height = place.altitude - down
    count = autopilot.payload.pictures & 0xFFFF
    return dialect.MAVLink_camera_feedback_message(
        micros(autopilot), 0, 0, count, *place.at(north, east), height, -down, roll, pitch, yaw, 0.0, 0, count
    )


def camera_image_captured(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """CAMERA_IMAGE_CAPTURED 263 of the camera protocol."""
    vehicle = autopilot.vehicle
    north, east, down = vehicle.place
    rotation = quaternion(vehicle.roll, vehicle.pitch, vehicle.yaw)
    height = round((place.altitude - down) * 1000)
    above, count = round(-down * 1000), autopilot.payload.pictures & 0x7FFFFFFF
    return dialect.MAVLink_camera_image_captured_message(
        millis(autopilot), 0, 0, *place.at(north, east), height, above, rotation, count, 1, b""
    )
