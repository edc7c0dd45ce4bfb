"""What the fake can send, by message id: one small function each, from the autopilot's state."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from lfield_sim.autopilot import Autopilot
from lfield_sim.mavlink.place import Place

NO_VALUE_16, NO_VALUE_32 = 0xFFFF, 0xFFFFFFFF


Builder = Callable[[Autopilot, Place], Any]


def _millis(autopilot: Autopilot) -> int:
    return int(autopilot.uptime * 1000) & 0xFFFFFFFF


def _heading(autopilot: Autopilot) -> float:
    return math.degrees(autopilot.vehicle.yaw) % 360.0


def _percent(autopilot: Autopilot) -> int:
    return round(autopilot.charge * 100)


def heartbeat(autopilot: Autopilot, _: Place) -> Any:
    """HEARTBEAT 0."""
    mode = dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    mode |= dialect.MAV_MODE_FLAG_SAFETY_ARMED if autopilot.armed else 0
    state = dialect.MAV_STATE_ACTIVE if autopilot.armed else dialect.MAV_STATE_STANDBY
    return dialect.MAVLink_heartbeat_message(
        autopilot.kind.mav_type,
        dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
        mode,
        autopilot.kind.modes[autopilot.mode],
        dialect.MAV_STATE_CRITICAL if autopilot.critical else state,
        3,
    )


def sys_status(autopilot: Autopilot, _: Place) -> Any:
    """SYS_STATUS 1: voltage in mV, current in 10 mA, remaining in percent."""
    volts, amperes = round(autopilot.volts * 1000), round(autopilot.current * 100)
    return dialect.MAVLink_sys_status_message(
        0, 0, 0, 200, volts, amperes, _percent(autopilot), 0, 0, 0, 0, 0, 0
    )


def gps_raw_int(autopilot: Autopilot, place: Place) -> Any:
    """GPS_RAW_INT 24: a good 3D fix."""
    north, east, down = autopilot.vehicle.place
    latitude, longitude = place.at(north, east)
    speed = math.hypot(*autopilot.vehicle.velocity[:2])
    altitude = round((place.altitude - down) * 1000)
    micros = int(autopilot.uptime * 1e6)
    return dialect.MAVLink_gps_raw_int_message(
        micros,
        3,
        latitude,
        longitude,
        altitude,
        90,
        90,
        round(speed * 100),
        round(_heading(autopilot) * 100),
        14,
    )


def attitude(autopilot: Autopilot, _: Place) -> Any:
    """ATTITUDE 30, radians."""
    vehicle = autopilot.vehicle
    return dialect.MAVLink_attitude_message(
        _millis(autopilot), vehicle.roll, vehicle.pitch, vehicle.yaw, 0.0, 0.0, 0.0
    )


def local_position_ned(autopilot: Autopilot, _: Place) -> Any:
    """LOCAL_POSITION_NED 32, about the origin (not about home)."""
    vehicle = autopilot.vehicle
    return dialect.MAVLink_local_position_ned_message(_millis(autopilot), *vehicle.place, *vehicle.velocity)


def global_position_int(autopilot: Autopilot, place: Place) -> Any:
    """GLOBAL_POSITION_INT 33."""
    vehicle = autopilot.vehicle
    north, east, down = vehicle.place
    latitude, longitude = place.at(north, east)
    return dialect.MAVLink_global_position_int_message(
        _millis(autopilot),
        latitude,
        longitude,
        round((place.altitude - down) * 1000),
        round((autopilot.home[2] - down) * 1000),
        *(round(v * 100) for v in vehicle.velocity),
        round(_heading(autopilot) * 100) % 36000,
    )


def gps_global_origin(_: Autopilot, place: Place) -> Any:
    """GPS_GLOBAL_ORIGIN 49."""
    latitude, longitude = place.at(0.0, 0.0)
    return dialect.MAVLink_gps_global_origin_message(latitude, longitude, round(place.altitude * 1000), 0)


def vfr_hud(autopilot: Autopilot, place: Place) -> Any:
    """VFR_HUD 74."""
    vehicle = autopilot.vehicle
    speed = math.hypot(*vehicle.velocity[:2])
    altitude = place.altitude - vehicle.place[2]
    throttle = 50 if vehicle.airborne else 0
    return dialect.MAVLink_vfr_hud_message(
        speed, speed, int(_heading(autopilot)), throttle, altitude, -vehicle.velocity[2]
    )


def battery_status(autopilot: Autopilot, _: Place) -> Any:
    """BATTERY_STATUS 147: one pack, its voltage in the first cell field."""
    used = round((1.0 - autopilot.charge) * autopilot.capacity)
    cells = [round(autopilot.volts * 1000)] + [NO_VALUE_16] * 9
    return dialect.MAVLink_battery_status_message(
        0, 0, 0, 32767, cells, round(autopilot.current * 100), used, -1, _percent(autopilot)
    )


def autopilot_version(autopilot: Autopilot, _: Place) -> Any:
    """AUTOPILOT_VERSION 148: 4.7 development, capabilities as measured."""
    version = 4 << 24 | 7 << 16
    return dialect.MAVLink_autopilot_version_message(
        0xFBEF, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0, [0] * 18
    )


def home_position(autopilot: Autopilot, place: Place) -> Any:
    """HOME_POSITION 242; the local part is left at 0, as ArduPilot does."""
    north, east, down = autopilot.home
    latitude, longitude = place.at(north, east)
    altitude = round((place.altitude - down) * 1000)
    return dialect.MAVLink_home_position_message(
        latitude, longitude, altitude, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
    )


def extended_sys_state(autopilot: Autopilot, _: Place) -> Any:
    """EXTENDED_SYS_STATE 245: the landed state of a copter, undefined for a rover."""
    if autopilot.kind.name != "copter":
        landed = dialect.MAV_LANDED_STATE_UNDEFINED
    elif not autopilot.vehicle.airborne:
        landed = dialect.MAV_LANDED_STATE_ON_GROUND
    elif autopilot.mode == "LAND":
        landed = dialect.MAV_LANDED_STATE_LANDING
    else:
        landed = dialect.MAV_LANDED_STATE_IN_AIR
    return dialect.MAVLink_extended_sys_state_message(dialect.MAV_VTOL_STATE_UNDEFINED, landed)


HEARTBEAT = 0

#: Everything that can be asked for, once (512) or as a stream (511).
MESSAGES: Mapping[int, Builder] = {
    HEARTBEAT: heartbeat,
    1: sys_status,
    24: gps_raw_int,
    30: attitude,
    32: local_position_ned,
    33: global_position_int,
    49: gps_global_origin,
    74: vfr_hud,
    147: battery_status,
    148: autopilot_version,
    242: home_position,
    245: extended_sys_state,
}

#: What REQUEST_DATA_STREAM (66) means by a stream number; 0 is all of them.
DATA_STREAMS: Mapping[int, tuple[int, ...]] = {
    1: (24,),
    2: (1, 24, 245),
    6: (32, 33),
    10: (30,),
    11: (74,),
    12: (147,),
}
