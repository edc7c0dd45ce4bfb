"""Messages about motion, built from the autopilot's state. Radians; the local frame is north, east, down."""

from __future__ import annotations

import math
from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.monitoring.arming_readiness import has_fix, has_position
from lfield_sim.autopilot.wind import GRAVITY
from lfield_sim.mavlink.geo import GeoOrigin, quaternion

#: Magnetic field in gauss.
FIELD = (0.21, 0.01, 0.43)
#: hPa and degrees Celsius at the ground.
PRESSURE, TEMPERATURE = 955.0, 15.0
UNKNOWN_COVARIANCE = [math.nan] * 21


def millis(autopilot: Autopilot) -> int:
    """Milliseconds since the start, as in most messages."""
    return int(autopilot.uptime * 1000) & 0xFFFFFFFF


def micros(autopilot: Autopilot) -> int:
    """Microseconds since the start."""
    return int(autopilot.uptime * 1e6)


def heading(autopilot: Autopilot) -> float:
    """Heading in degrees from 0 to 360."""
    return math.degrees(autopilot.vehicle.yaw) % 360.0


def attitude(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """ATTITUDE 30."""
    vehicle = autopilot.vehicle
    return dialect.MAVLink_attitude_message(
        millis(autopilot), vehicle.roll, vehicle.pitch, vehicle.yaw, 0.0, 0.0, vehicle.yaw_rate
    )


def attitude_quaternion(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """ATTITUDE_QUATERNION 31."""
    vehicle = autopilot.vehicle
    rotation = quaternion(vehicle.roll, vehicle.pitch, vehicle.yaw)
    return dialect.MAVLink_attitude_quaternion_message(
        millis(autopilot), *rotation, 0.0, 0.0, vehicle.yaw_rate
    )


def estimated(autopilot: Autopilot) -> tuple[Vector, Vector]:
    """Estimated position and velocity: without GPS they drift."""
    vehicle, estimate = autopilot.vehicle, autopilot.estimate
    north, east, down = (p + o for p, o in zip(vehicle.place, estimate.offset, strict=True))
    to_north, to_east, to_down = (v + d for v, d in zip(vehicle.velocity, estimate.drift, strict=True))
    return (north, east, down), (to_north, to_east, to_down)


def local_position_ned(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """LOCAL_POSITION_NED 32, relative to the origin (not to home)."""
    place, velocity = estimated(autopilot)
    return dialect.MAVLink_local_position_ned_message(millis(autopilot), *place, *velocity)


def global_position_int(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """GLOBAL_POSITION_INT 33; all zero before a fix."""
    (north, east, down), velocity = estimated(autopilot)
    if not has_position(autopilot):
        return dialect.MAVLink_global_position_int_message(millis(autopilot), *[0] * 8)
    return dialect.MAVLink_global_position_int_message(
        millis(autopilot),
        *place.at(north, east),
        round((place.altitude - down) * 1000),
        round((autopilot.home[2] - down) * 1000),
        *(round(v * 100) for v in velocity),
        round(heading(autopilot) * 100) % 36000,
    )


def odometry(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """ODOMETRY 331: pose in the local frame, velocity in the body's."""
    vehicle = autopilot.vehicle
    north, east, down = vehicle.velocity
    cos, sin = math.cos(vehicle.yaw), math.sin(vehicle.yaw)
    return dialect.MAVLink_odometry_message(
        micros(autopilot),
        dialect.MAV_FRAME_LOCAL_NED,
        dialect.MAV_FRAME_BODY_FRD,
        *vehicle.place,
        quaternion(vehicle.roll, vehicle.pitch, vehicle.yaw),
        *(cos * north + sin * east, -sin * north + cos * east, down),
        *(0.0, 0.0, vehicle.yaw_rate),
        UNKNOWN_COVARIANCE,
        UNKNOWN_COVARIANCE,
        min(autopilot.boots, 255),
        dialect.MAV_ESTIMATOR_TYPE_AUTOPILOT,
        100,
    )


def gps_raw_int(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """GPS_RAW_INT 24: a good 3D fix, or none."""
    north, east, down = autopilot.vehicle.place
    north += autopilot.gps_glitch
    if not has_fix(autopilot):
        return dialect.MAVLink_gps_raw_int_message(
            micros(autopilot), dialect.GPS_FIX_TYPE_NO_FIX, 0, 0, 0, 9999, 9999, 0, 0, 0
        )
    speed = math.hypot(*autopilot.vehicle.velocity[:2])
    return dialect.MAVLink_gps_raw_int_message(
        micros(autopilot),
        dialect.GPS_FIX_TYPE_3D_FIX,
        *place.at(north, east),
        round((place.altitude - down) * 1000),
        90,
        90,
        round(speed * 100),
        round(heading(autopilot) * 100),
        14,
    )


def gps_global_origin(_: Autopilot, place: GeoOrigin) -> Any:
    """GPS_GLOBAL_ORIGIN 49."""
    return dialect.MAVLink_gps_global_origin_message(*place.at(0.0, 0.0), round(place.altitude * 1000), 0)


def vfr_hud(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """VFR_HUD 74; ArduCopter's airspeed is from its wind estimate, PX4 has none without a sensor."""
    vehicle = autopilot.vehicle
    speed = math.hypot(*vehicle.velocity[:2])
    airspeed = vehicle.wind.airspeed(vehicle.velocity) if vehicle.airborne else speed
    if autopilot.flavour.submodes:
        airspeed = math.nan
    altitude = place.altitude - vehicle.place[2]
    throttle = 50 if vehicle.airborne else 0
    return dialect.MAVLink_vfr_hud_message(
        airspeed, speed, int(heading(autopilot)), throttle, altitude, -vehicle.velocity[2]
    )


def wind(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """WIND 168 of ArduPilot: direction of origin in degrees, and speed."""
    north, east = autopilot.vehicle.wind.velocity
    return dialect.MAVLink_wind_message(math.degrees(math.atan2(-east, -north)), math.hypot(north, east), 0.0)


def wind_cov(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """WIND_COV 231 of PX4: its velocity."""
    north, east = autopilot.vehicle.wind.velocity
    altitude = place.altitude - autopilot.vehicle.place[2]
    return dialect.MAVLink_wind_cov_message(
        micros(autopilot), north, east, 0.0, math.nan, math.nan, altitude, 0.1, 0.0
    )


def _force(autopilot: Autopilot) -> tuple[float, float, float]:
    """The specific force in m/s2, in the levelled body frame."""
    vehicle = autopilot.vehicle
    north, east, down = vehicle.acceleration
    cos, sin = math.cos(vehicle.yaw), math.sin(vehicle.yaw)
    return cos * north + sin * east, -sin * north + cos * east, down - GRAVITY


def scaled_imu(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """SCALED_IMU 26: milli-g, mrad/s, milligauss."""
    # An impact exceeds the field's range: the sensor saturates.
    force = (max(-32768, min(32767, round(a / GRAVITY * 1000))) for a in _force(autopilot))
    rate = round(autopilot.vehicle.yaw_rate * 1000)
    field = (round(f * 1000) for f in FIELD)
    return dialect.MAVLink_scaled_imu_message(
        millis(autopilot), *force, 0, 0, rate, *field, round(TEMPERATURE * 100)
    )


def raw_imu(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """RAW_IMU 27, in the units of SCALED_IMU, as on ArduPilot."""
    scaled = scaled_imu(autopilot, place)
    force = (scaled.xacc, scaled.yacc, scaled.zacc)
    rates = (scaled.xgyro, scaled.ygyro, scaled.zgyro)
    field = (scaled.xmag, scaled.ymag, scaled.zmag)
    return dialect.MAVLink_raw_imu_message(micros(autopilot), *force, *rates, *field, 0, scaled.temperature)


def highres_imu(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """HIGHRES_IMU 105."""
    height = -autopilot.vehicle.place[2]
    pressure = PRESSURE - 0.12 * height
    return dialect.MAVLink_highres_imu_message(
        micros(autopilot),
        *_force(autopilot),
        *(0.0, 0.0, autopilot.vehicle.yaw_rate),
        *FIELD,
        *(pressure, 0.0, place.altitude + height, TEMPERATURE),
        0x1FFF,
    )
