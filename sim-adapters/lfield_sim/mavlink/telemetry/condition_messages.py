"""Messages about the condition of a vehicle: type, mode, health, battery, home, fence."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import Autopilot
from lfield_sim.autopilot.flavours import Role
from lfield_sim.autopilot.monitoring.arming_readiness import has_fix, startup_progress, trusts_position
from lfield_sim.autopilot.takeoff_landing import landed_state
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.telemetry.motion_messages import micros, millis

NO_VALUE_16 = 0xFFFF
#: The share of a cold start in which ArduPilot reports booting.
BOOTED = 0.07
#: Seconds since 1970 at the start of the simulated device's GPS clock: 2026-11-01, for reproducible runs.
EPOCH = 1_793_491_200
#: MAV_SYS_STATUS_SENSOR: inertial, magnetic, pressure, GPS, control, motors, battery, pre-arm checks.
COMPASS = 0x4
GPS, PREARM, FENCE = 0x20, 0x10000000, 0x100000
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | GPS | 0x400 | 0x800 | 0x1000 | 0x2000 | 0x4000 | 0x8000 | FENCE
SENSORS |= 0x200000 | 0x2000000 | PREARM
#: EKF_STATUS_REPORT: attitude, velocities, positions; and without a position.
EKF_GOOD, EKF_BLIND = 0x33F, 0xA7
#: ESTIMATOR_STATUS: the same for PX4.
ESTIMATOR_GOOD, ESTIMATOR_BLIND = 0x37F, 0xA5


def _percent(autopilot: Autopilot) -> int:
    return round(autopilot.battery.charge * 100)


def heartbeat(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """HEARTBEAT 0."""
    return dialect.MAVLink_heartbeat_message(
        autopilot.kind.mav_type,
        autopilot.flavour.autopilot,
        _base_mode(autopilot),
        autopilot.kind.modes[autopilot.mode].number,
        _state(autopilot),
        3,
    )


def _base_mode(autopilot: Autopilot) -> int:
    """MAV_MODE_FLAG of the mode; guided for an ArduCopter with position control."""
    flags = autopilot.kind.modes[autopilot.mode].flags
    if autopilot.flies and not autopilot.flavour.submodes:
        if startup_progress(autopilot) < BOOTED:
            flags |= dialect.MAV_MODE_FLAG_GUIDED_ENABLED
        elif autopilot.role is Role.RETURN and not autopilot.armed:
            flags &= ~dialect.MAV_MODE_FLAG_GUIDED_ENABLED
    return int(flags | (dialect.MAV_MODE_FLAG_SAFETY_ARMED if autopilot.armed else 0))


def _state(autopilot: Autopilot) -> int:
    """MAV_STATE: an ArduCopter is active in the air, a rover unless it holds, PX4 when it is armed."""
    if autopilot.role is Role.TERMINATE:
        return int(dialect.MAV_STATE_FLIGHT_TERMINATION)
    if autopilot.critical:
        return int(dialect.MAV_STATE_CRITICAL)
    if autopilot.calibrating:
        return int(dialect.MAV_STATE_CALIBRATING)
    if startup_progress(autopilot) < BOOTED and not autopilot.flavour.submodes:
        return int(dialect.MAV_STATE_BOOT if autopilot.flies else dialect.MAV_STATE_CALIBRATING)
    if autopilot.flavour.submodes:
        if not autopilot.armed and autopilot.unfit:
            return int(dialect.MAV_STATE_UNINIT)
        active = autopilot.armed
    else:
        active = not autopilot.landed if autopilot.flies else autopilot.role is not Role.HOLD
    return int(dialect.MAV_STATE_ACTIVE if active else dialect.MAV_STATE_STANDBY)


def current_mode(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """CURRENT_MODE 436 of PX4: the actual and the commanded mode."""
    mode, intended = (autopilot.kind.modes[name] for name in (autopilot.mode, autopilot.intended))
    return dialect.MAVLink_current_mode_message(mode.standard, mode.number, intended.number)


def sys_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """SYS_STATUS 1: sensors and whether it may be armed; mV, 10 mA, percent."""
    battery = autopilot.battery
    # PX4 sets the pre-arm bit in its health only, not in present or enabled, and no bit of its fence.
    present = SENSORS & ~PREARM & ~FENCE if autopilot.flavour.submodes else SENSORS
    # ArduPilot's GPS is present from its first fix.
    present &= ~0 if startup_progress(autopilot) >= autopilot.kind.warming.fix else ~GPS
    enabled = present if autopilot.value(autopilot.flavour.fence.enable) else present & ~FENCE
    health = present | PREARM
    if not has_fix(autopilot):
        health &= ~GPS
    if not autopilot.estimate.has_compass:
        health &= ~COMPASS
    # PX4 clears the bit in flight as well.
    if autopilot.unfit and (autopilot.flavour.submodes or not autopilot.armed):
        health &= ~PREARM
    if autopilot.failsafes.fences.breach:
        health &= ~FENCE
    volts, amperes = round(battery.volts * 1000), round(battery.current * 100)
    return dialect.MAVLink_sys_status_message(
        present, enabled, health, 200, volts, amperes, _percent(autopilot), 0, 0, 0, 0, 0, 0
    )


def system_time(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """SYSTEM_TIME 2."""
    unix = int((EPOCH + autopilot.now) * 1e6)
    return dialect.MAVLink_system_time_message(unix, millis(autopilot))


def ping(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """PING 4 to all."""
    return dialect.MAVLink_ping_message(micros(autopilot), int(autopilot.uptime), 0, 0)


def timesync(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """TIMESYNC 111, a request to all."""
    return dialect.MAVLink_timesync_message(0, int(autopilot.uptime * 1e9))


def battery_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """BATTERY_STATUS 147: one pack, its voltage in the first cell field."""
    battery = autopilot.battery
    cells = [round(battery.volts * 1000)] + [NO_VALUE_16] * 9
    # PX4 reports function and type of the battery.
    known = autopilot.flavour.submodes
    return dialect.MAVLink_battery_status_message(
        0,
        dialect.MAV_BATTERY_FUNCTION_ALL if known else dialect.MAV_BATTERY_FUNCTION_UNKNOWN,
        dialect.MAV_BATTERY_TYPE_LIPO if known else dialect.MAV_BATTERY_TYPE_UNKNOWN,
        32767,
        cells,
        round(battery.current * 100),
        round(battery.used),
        -1,
        _percent(autopilot),
        charge_state=dialect.MAV_BATTERY_CHARGE_STATE_OK,
    )


def rc_channels(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """RC_CHANNELS 65: no radio control."""
    return dialect.MAVLink_rc_channels_message(millis(autopilot), 0, *[NO_VALUE_16] * 18, 255)


def autopilot_version(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """AUTOPILOT_VERSION 148: ArduPilot has its board id in uid2 only, PX4 a part of it in uid, too."""
    flavour, board = autopilot.flavour, autopilot.board
    uid, uid2 = board & (1 << 64) - 1 if flavour.submodes else 0, [*board.to_bytes(12), *[0] * 6]
    return dialect.MAVLink_autopilot_version_message(
        flavour.capabilities, flavour.version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, uid, uid2
    )


def home_position(autopilot: Autopilot, place: GeoOrigin) -> Any:
    """HOME_POSITION 242, with its local position."""
    north, east, down = autopilot.home
    return dialect.MAVLink_home_position_message(
        *place.at(north, east),
        round((place.altitude - down) * 1000),
        *autopilot.home,
        [1.0, 0.0, 0.0, 0.0],
        *(0.0, 0.0, 0.0),
    )


def extended_sys_state(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """EXTENDED_SYS_STATE 245: the landed state."""
    multicopter = autopilot.flies and not autopilot.flavour.submodes
    vtol = dialect.MAV_VTOL_STATE_MC if multicopter else dialect.MAV_VTOL_STATE_UNDEFINED
    return dialect.MAVLink_extended_sys_state_message(vtol, int(landed_state(autopilot)))


def fence_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """FENCE_STATUS 162; fence avoidance limits the speed."""
    avoids = autopilot.vehicle.velocity_fence is not None
    mitigation = dialect.FENCE_MITIGATE_VEL_LIMIT if avoids else dialect.FENCE_MITIGATE_NONE
    monitor = autopilot.failsafes.fences
    time = int(max(0.0, monitor.breached_at - autopilot.booted) * 1000)
    return dialect.MAVLink_fence_status_message(
        1 if monitor.breach else 0, monitor.breaches, monitor.breach, time & 0xFFFFFFFF, mitigation
    )


def ekf_status_report(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """EKF_STATUS_REPORT 193, ArduPilot's."""
    flags = EKF_GOOD if trusts_position(autopilot) else EKF_BLIND
    return dialect.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.0)


def estimator_status(autopilot: Autopilot, _: GeoOrigin) -> Any:
    """ESTIMATOR_STATUS 230, PX4's."""
    flags = ESTIMATOR_GOOD if trusts_position(autopilot) else ESTIMATOR_BLIND
    return dialect.MAVLink_estimator_status_message(
        micros(autopilot), flags, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5, 0.5
    )
