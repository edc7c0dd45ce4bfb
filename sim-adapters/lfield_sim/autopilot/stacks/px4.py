"""PX4 1.17 copters and rovers as data: modes, parameters, failsafes, texts.

https://docs.px4.io/main/en/advanced_config/parameter_reference.html; a custom mode is main << 16 | sub << 24
(px4_custom_mode.h).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from lfield_sim.autopilot.body.estimator import BlindRule
from lfield_sim.autopilot.flavours import (
    BatteryLevel,
    FenceRule,
    Flavour,
    FlightMode,
    GcsRule,
    MavResult,
    Role,
    StartupTiming,
    VehicleKind,
)
from lfield_sim.autopilot.ground_vehicle import Wheels
from lfield_sim.autopilot.speed_control import Px4SpeedControl
from lfield_sim.autopilot.vehicle import Limits, Response

_WARN, _LAND, _RETURN = 0, 2, 3
_LINK_ACTIONS = {1: Role.HOLD, 2: Role.RETURN, 3: Role.LAND, 5: Role.TERMINATE}

FLAVOUR = Flavour(
    name="px4",
    autopilot=12,
    version=1 << 24 | 17 << 16 | 255,
    # Missions and commands in floats and integers, byte-wise parameters, FTP, attitude and local targets,
    # terminate, MAVLink 2, fence, rally.
    capabilities=0xE8FF,
    refusal=MavResult.TEMPORARILY_REJECTED,
    denial="Preflight Fail: {reason}\t",
    verdict="Arming denied: Resolve system health failures first\t",
    armed="Armed by external command\t",
    disarmed="Disarmed by external command\t",
    airborne_text="Disarming denied: not landed\t",
    idle_text="Disarmed by auto preflight disarming\t",
    serves_components=False,
    submodes=True,
    needs_stream=True,
    takeoff_mode=True,
    home_item=False,
    setpoint_timeout="COM_OF_LOSS_T",
    disarm_delay="COM_DISARM_PRFLT",
    land_delay="COM_DISARM_LAND",
    settles=2.5,
    landed_text="Disarmed by landing\t",
    gcs=GcsRule(
        action="NAV_DLL_ACT",
        timeout="COM_DL_LOSS_T",
        actions=_LINK_ACTIONS,
        text="Failsafe activated\t",
        lost_text="Connection to ground station lost\t",
        unfit_text="Preflight Fail: No connection to the GCS",
        hold_text="Failsafe activated: entering Hold for {pause:.0f} seconds\t",
        cleared="GCS connection regained\t",
        pause="COM_FAIL_ACT_T",
        late=1.5,
        forbids=True,
    ),
    battery=(
        BatteryLevel(
            "BAT_LOW_THR", False, "COM_LOW_BAT_ACT", {}, "Low battery level! Return advised"
        ),
        BatteryLevel(
            "BAT_CRIT_THR", False, "COM_LOW_BAT_ACT", {_LAND: Role.LAND, _RETURN: Role.RETURN},
            "Critical battery level! Return now",
        ),
        BatteryLevel(
            "BAT_EMERGEN_THR", False, "COM_LOW_BAT_ACT", {_LAND: Role.LAND, _RETURN: Role.LAND},
            "Dangerous battery level! Land immediately",
        ),
    ),
    fence=FenceRule(
        enable="GF_ACTION",
        action="GF_ACTION",
        actions={2: Role.HOLD, 3: Role.RETURN, 4: Role.TERMINATE, 5: Role.LAND},
        radius="GF_MAX_HOR_DIST",
        ceiling="GF_MAX_VER_DIST",
        circle_text="Geofence: exceeding maximum distance to Home",
        ceiling_text="Geofence: exceeding maximum altitude above Home",
        shape_text="Geofence: approaching or outside geofence",
        outside_text="Reposition is outside geofence\t",
        hold_text="Failsafe activated: entering Hold for {pause:.0f} seconds\t",
        pause="COM_FAIL_ACT_T",
    ),
    position_lost="Failsafe activated",
    blind=BlindRule(5.4, 4.5, refusal="Switching to {mode} is currently not available\t"),
    capacity="BAT1_CAPACITY",
    streams={
        0: 1.0, 1: 5.0, 2: 1.0, 4: 1.0, 24: 8.0, 30: 100.0, 31: 50.0, 32: 30.0, 33: 50.0, 36: 10.0, 42: 1.0,
        74: 10.0, 105: 50.0, 111: 10.0, 147: 0.5, 230: 1.0, 231: 10.0, 242: 0.5, 245: 5.0, 331: 30.0,
        436: 0.5,
    },
    # SCALED_IMU, RAW_IMU, RC_CHANNELS, FENCE_STATUS, WIND, EKF_STATUS_REPORT
    unknown_messages=frozenset({26, 27, 65, 162, 168, 193}),
    unasked_only=frozenset({0, 42}),
    streamed_only=frozenset({436}),
    # GPS_GLOBAL_ORIGIN
    sent_once=frozenset({49}),
    heeds_groups=False,
    return_cone=1.0,
    grace=0.14,
    unavailable="Switching to {mode} is currently not available\t",
    no_mission=("Switching to Mission is currently not available\t",),
    mute=3.0,
    stale=5.0,
    drifts=True,
    # CONDITION_YAW, DO_SET_RELAY, DO_SET_SERVO, DO_WINCH, the old mount commands
    unsupported=frozenset({115, 181, 183, 205, 42600}),
)  # fmt: skip

FAST, FAST_GOAL = Response(1.0, 0.45), Response(0.9, 0.5)
#: The share of its own landing speed at which a copter lands (px4-copter.f-fence-landing).
SINKS = 0.87
#: PX4 reports all values at once, and may be armed some seconds later.
WARMING = StartupTiming(
    fix=0.0,
    home=0.0,
    origin=0.0,
    position=0.0,
    estimate=0.55,
    reasons=((0.4, None), (1.0, ())),
)


def _custom(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


#: Speeds in m/s, heights in m, times in s, charges as a share of 1.
COMMON: Mapping[str, float] = {
    "BAT1_CAPACITY": 3300,
    "BAT_CRIT_THR": 0.07,
    "BAT_EMERGEN_THR": 0.05,
    "BAT_LOW_THR": 0.15,
    "CAL_ACC0_ID": 1310988,
    "CAL_GYRO0_ID": 1310988,
    "CAL_MAG0_ID": 197388,
    "COM_DISARM_LAND": 2.0,
    "COM_DISARM_PRFLT": 10.0,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "COM_LOW_BAT_ACT": _WARN,
    "COM_OBL_RC_ACT": 0,
    "COM_OF_LOSS_T": 1.0,
    "COM_RC_OVERRIDE": 1,
    "GF_ACTION": 2,
    "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0,
    "MAV_SYS_ID": 1,
    "NAV_ACC_RAD": 2.0,
    "NAV_DLL_ACT": 0,
    "SYS_AUTOSTART": 10040,
    "SYS_HITL": 0,
}
COPTER_PARAMETERS: Mapping[str, float] = {
    **COMMON,
    "MIS_TAKEOFF_ALT": 2.5,
    "MPC_ACC_HOR": 3.0,
    "MPC_LAND_SPEED": 0.7,
    "MPC_TILTMAX_AIR": 45.0,
    "MPC_TKO_SPEED": 1.5,
    "MPC_XY_CRUISE": 5.0,
    "MPC_XY_VEL_MAX": 12.0,
    "MPC_Z_VEL_MAX_DN": 1.5,
    "MPC_Z_VEL_MAX_UP": 3.0,
    "RTL_RETURN_ALT": 30.0,
}
ROVER_PARAMETERS: Mapping[str, float] = {**COMMON, "RO_ACCEL_LIM": 3.0, "RO_SPEED_LIM": 3.0}

#: MAV_MODE_FLAG: custom; stabilised; manual; auto.
_CUSTOM = 1
_LEVELLED = _CUSTOM | 16
_MANUAL = _LEVELLED | 64
_AUTO = _LEVELLED | 8 | 4

_MODES = {
    "MANUAL": FlightMode(_custom(1), Role.MANUAL, _MANUAL),
    "ALTCTL": FlightMode(_custom(2), Role.MANUAL, _MANUAL, standard=4),
    "POSCTL": FlightMode(_custom(3), Role.MANUAL, _MANUAL, standard=1),
    "ACRO": FlightMode(_custom(5), Role.MANUAL, _CUSTOM | 64),
    "OFFBOARD": FlightMode(_custom(6), Role.GUIDED, _LEVELLED),
    "STABILIZED": FlightMode(_custom(7), Role.MANUAL, _MANUAL),
    "AUTO.READY": FlightMode(_custom(4, 1), Role.MANUAL, _AUTO),
    "AUTO.LOITER": FlightMode(_custom(4, 3), Role.HOLD, _AUTO),
    "AUTO.MISSION": FlightMode(_custom(4, 4), Role.MISSION, _AUTO, standard=6),
    "AUTO.RTL": FlightMode(_custom(4, 5), Role.RETURN, _AUTO, standard=5),
    "TERMINATION": FlightMode(_custom(10), Role.TERMINATE, _CUSTOM, armable=False),
}
KINDS = {
    "copter": VehicleKind(
        "copter",
        2,
        FLAVOUR,
        {
            **_MODES,
            "AUTO.TAKEOFF": FlightMode(_custom(4, 2), Role.TAKEOFF, _AUTO, standard=8),
            "AUTO.LAND": FlightMode(_custom(4, 6), Role.LAND, _AUTO, armable=False, standard=7),
            "POSCTL.ORBIT": FlightMode(_custom(3, 1), Role.ORBIT, _LEVELLED, armable=False, standard=2),
        },
        "AUTO.LOITER",
        COPTER_PARAMETERS,
        {
            "cruise": ("MPC_XY_CRUISE", 1.0),
            "climb": ("MPC_Z_VEL_MAX_UP", 1.0),
            "descend": ("MPC_Z_VEL_MAX_DN", 1.0),
            "land": ("MPC_LAND_SPEED", 1.0 / SINKS),
            "acceleration": ("MPC_ACC_HOR", 1.0),
            "takeoff": ("MPC_TKO_SPEED", 1.0),
            "top": ("MPC_XY_VEL_MAX", 1.0),
            "tilt": ("MPC_TILTMAX_AIR", math.degrees(1.0)),
        },
        Px4SpeedControl,
        WARMING,
        # Of 1 m/s it flies 0.77 after 2 s (px4-copter.d-velocity), of 3 m/s 2.1 after 3 s, 2.6 after 8, 2.86
        # after 14 (px4-copter.deaths-6) and 2.95 over 200 m (facts-3, 16).
        Limits(
            braking=1.75,
            jerk=4.0,
            spool=0.87,
            nose_follows=False,
            lift=0.3,
            sets_out=0.74,
            learns=10.0,
        ),
        return_height=("RTL_RETURN_ALT", 1.0),
        takeoff_height="MIS_TAKEOFF_ALT",
    ),
    "rover": VehicleKind(
        "rover",
        10,
        FLAVOUR,
        {
            **_MODES,
            "AUTO.TAKEOFF": FlightMode(_custom(4, 2), Role.TAKEOFF, _AUTO, standard=8),
            "AUTO.LAND": FlightMode(_custom(4, 6), Role.LAND, _AUTO, armable=False, standard=7),
        },
        "AUTO.LOITER",
        ROVER_PARAMETERS,
        {"cruise": ("RO_SPEED_LIM", 1.0), "acceleration": ("RO_ACCEL_LIM", 1.0)},
        Px4SpeedControl,
        WARMING,
        # The rover drives 0.5 m/s faster than commanded. It turns back to a position behind it at once, in a
        # circle of 1.9 m, and brakes from 2.6 m before one (trace l-px4-rover: 33, 42 and 19 s).
        Limits(braking=2.4, jerk=5.0, yaw_rate=2.7, goal_response=FAST_GOAL, velocity_response=FAST),
        wheels=Wheels(0.93, tight=2.3, brakes=math.inf, arrives=0.5, returns=True),
    ),
}
