"""ArduCopter and ArduRover 4.7 as data: modes, parameters, failsafes, texts.

https://ardupilot.org/copter/docs/parameters.html, https://ardupilot.org/rover/docs/parameters.html
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec.structs import replace

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
from lfield_sim.autopilot.speed_control import CopterSpeedControl, RoverSpeedControl
from lfield_sim.autopilot.vehicle import Limits, Response

_BATTERY_ACTIONS = {1: Role.LAND, 2: Role.RETURN, 3: Role.RETURN, 4: Role.RETURN, 5: Role.TERMINATE}

COPTER_FLAVOUR = Flavour(
    name="ardupilot",
    autopilot=3,
    version=4 << 24 | 7 << 16,
    capabilities=0xFBEF,
    refusal=MavResult.FAILED,
    denial="Arm: {reason}",
    warning="PreArm: {reason}",
    armed="Arming motors",
    disarmed="Disarming motors",
    serves_components=True,
    submodes=False,
    needs_stream=False,
    takeoff_mode=False,
    home_item=True,
    setpoint_timeout="GUID_TIMEOUT",
    disarm_delay="DISARM_DELAY",
    land_delay=0.5,
    settles=1.6,
    landed_text="Disarming motors",
    gcs=GcsRule(
        action="FS_GCS_ENABLE",
        timeout="FS_GCS_TIMEOUT",
        actions={
            1: Role.RETURN, 3: Role.RETURN, 4: Role.RETURN, 5: Role.LAND, 6: Role.RETURN, 7: Role.HOLD,
        },
        text="GCS Failsafe",
        cleared="GCS Failsafe Cleared",
        options="FS_OPTIONS",
        station="MAV_GCS_SYSID",
        stations_to="MAV_GCS_SYSID_HI",
        continue_text="GCS Failsafe - Continuing Landing",
        forbids=True,
        refusal="GCS failsafe on",
        check_period=0.3325,
    ),
    battery=(
        BatteryLevel(
            "BATT_LOW_MAH", True, "BATT_FS_LOW_ACT", _BATTERY_ACTIONS,
            "Battery 1 is low {volts:.2f}V used {used:.0f} mAh",
        ),
        BatteryLevel(
            "BATT_CRT_MAH", True, "BATT_FS_CRT_ACT", _BATTERY_ACTIONS,
            "Battery 1 is critical {volts:.2f}V used {used:.0f} mAh",
        ),
    ),
    fence=FenceRule(
        enable="FENCE_ENABLE",
        action="FENCE_ACTION",
        actions={1: Role.RETURN, 2: Role.LAND, 3: Role.RETURN, 4: Role.HOLD, 5: Role.RETURN},
        radius="FENCE_RADIUS",
        ceiling="FENCE_ALT_MAX",
        circle_text="Circle fence breached",
        ceiling_text="Max Alt fence breached",
        shape_text="Polygon fence breached",
        blind_text="Fence enabled, need position estimate",
        avoid="AVOID_ENABLE",
        margin="FENCE_MARGIN",
        recovery_text="Manual recovery started",
        cleared_text="Fence breach cleared",
    ),
    position_lost="EKF Failsafe: changed to LAND Mode",
    blind=BlindRule(
        8.1, 0.05, 1.3, "EKF Failsafe Cleared", "Mode change to {mode} failed: requires position"
    ),
    capacity="BATT_CAPACITY",
    # DO_ORBIT is PX4's; ArduCopter circles in its mode CIRCLE.
    unsupported=frozenset({34, 187}),
    # PING, HIGHRES_IMU, ESTIMATOR_STATUS, WIND_COV, ODOMETRY, CURRENT_MODE
    unknown_messages=frozenset({4, 105, 230, 231, 331, 436}),
    sends_modes=True,
    sends_home=True,
    # TIMESYNC
    streams={111: 0.1},
    idle_text="Disarming motors",
    battery_text="Battery Failsafe",
    battery_refusal="Battery failsafe",
    thrust_loss="Potential Thrust Loss (1)",
    no_mission=("Mode change to AUTO failed: init failed",),
)  # fmt: skip
ROVER_FLAVOUR = replace(
    COPTER_FLAVOUR,
    armed="Throttle armed",
    disarmed="Throttle disarmed",
    unarmable="Mode not armable",
    no_mission=("No Mission. Can't set AUTO.", "Flight mode change failed"),
    setpoint_timeout="",
    # ArduPilot streams every group once a second, and none faster than half its loop of 50 Hz.
    streams=dict.fromkeys((1, 2, 24, 27, 30, 32, 33, 36, 42, 65, 74, 147, 193), 1.0) | {111: 0.1},
    fastest=49.0,
    # No terminate, no terrain.
    capabilities=0xF1EF,
    ignored_text="Ignoring SET_POSITION_TARGET_LOCAL_NED; set ACC_IGNORE in mask",
    setpoint_text="target not received last 3secs, stopping",
    # NAV_LAND, NAV_TAKEOFF, CONDITION_YAW, DO_FLIGHTTERMINATION, NAV_SET_YAW_SPEED
    unsupported=COPTER_FLAVOUR.unsupported | {21, 22, 115, 185, 213},
    gcs=replace(
        COPTER_FLAVOUR.gcs,
        text="Radio Failsafe",
        late="FS_TIMEOUT",
        check_period=0.1,
        forbids=False,
        acts_disarmed=True,
        enable="FS_GCS_ENABLE",
        action="FS_ACTION",
        actions={1: Role.RETURN, 2: Role.HOLD, 3: Role.RETURN, 4: Role.RETURN},
        options="",
    ),
    fence=replace(
        COPTER_FLAVOUR.fence,
        actions={1: Role.RETURN, 2: Role.HOLD, 3: Role.RETURN, 4: Role.RETURN},
        ceiling="",
        circle_text="",
        cleared_text="",
        refuses=False,
    ),
    position_lost="EKF failsafe",
)


def _both(text: str) -> tuple[str, ...]:
    """The texts of both estimators."""
    return tuple(f"EKF3 IMU{number} {text}" for number in range(2))


_ALIGNED = (
    (0.138, (*_both("tilt alignment complete"), *_both("MAG0 initial yaw alignment complete"))),
    (0.23, ("GPS 1: probing for u-blox at 230400 baud", "GPS 1: detected u-blox")),
    (0.469, (*_both("origin set"), "Field Elevation Set: 584m")),
)
_UNLEVEL = ("Need Alt Estimate", "Accels inconsistent", "EKF attitude is bad", "AHRS: waiting for home")
COPTER_WARMING = StartupTiming(
    fix=0.237,
    home=0.47,
    origin=0.47,
    position=0.98,
    by_hand=0.55,
    estimate=0.985,
    reasons=(
        (0.05, ("System not initialised",)),
        (0.14, _UNLEVEL),
        (0.29, ("Accels inconsistent", "AHRS: waiting for home")),
        (0.47, ("Gyros inconsistent", "AHRS: waiting for home")),
        (1.0, ("Need Position Estimate",)),
    ),
    texts=(
        (0.008, ("Calibrating barometer",)),
        (0.045, ("Barometer 1 calibration complete", "Barometer 2 calibration complete")),
        (0.058, ("ArduPilot Ready", "AHRS: DCM active")),
        (0.065, ("RC7: SaveWaypoint LOW",)),
        (0.104, (*_both("initialised"), "AHRS: EKF3 active")),
        *_ALIGNED,
        (0.975, _both("is using GPS")),
    ),
)
#: A rover reports home and position long before it may be armed.
ROVER_WARMING = StartupTiming(
    fix=0.237,
    home=0.244,
    origin=0.5,
    position=0.247,
    by_hand=0.5,
    estimate=1.0,
    reasons=(
        (0.05, ("System not initialised",)),
        (0.25, ("Accels inconsistent", "AHRS: waiting for home")),
        (0.29, ("Accels inconsistent", "AHRS: not using configured AHRS type")),
        (0.47, ("Gyros inconsistent", "AHRS: not using configured AHRS type")),
        (1.0, ("AHRS: not using configured AHRS type",)),
    ),
    texts=(
        (0.041, ("Barometer 1 calibration complete", "Barometer 2 calibration complete")),
        (0.042, ("Beginning INS calibration. Do not move vehicle",)),
        (0.056, ("INS: alloc 6144 bytes for ISB (free=524288)", "ArduPilot Ready")),
        (0.057, ("RCInput: decoding UDP (Pulses)", "AHRS: DCM active")),
        (0.103, _both("initialised")),
        *_ALIGNED,
        (0.99, (*_both("is using GPS"), "AHRS: EKF3 active")),
    ),
)

#: Hundredths of a degree in a radian.
CENTIDEGREES = 100.0 * math.degrees(1.0)
#: Parameters of both. Times in s, charges in mAh.
COMMON: Mapping[str, float] = {
    "ARMING_CHECK": 1,
    "BATT_CAPACITY": 3300,
    "BATT_CRT_MAH": 0,
    "BATT_FS_CRT_ACT": 0,
    "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_MAH": 660,
    "AVOID_ENABLE": 3,
    "FENCE_ACTION": 1,
    "FENCE_ENABLE": 0,
    "FENCE_MARGIN": 2,
    "FENCE_RADIUS": 300,
    "FENCE_TOTAL": 0,
    "FENCE_TYPE": 7,
    "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5,
    "MAV_GCS_SYSID": 255,
    "MAV_GCS_SYSID_HI": 0,
    "MIS_TOTAL": 0,
    "RALLY_TOTAL": 0,
}
#: Speeds of a copter in cm/s, angles in cdeg, heights in cm except the fence's in m.
COPTER_PARAMETERS: Mapping[str, float] = {
    **COMMON,
    "ANGLE_MAX": 3000,
    "CIRCLE_RADIUS": 1000,
    "CIRCLE_RATE": 20,
    "DISARM_DELAY": 10,
    "FENCE_ALT_MAX": 100,
    "FS_OPTIONS": 16,
    "GUID_TIMEOUT": 3,
    "LAND_SPEED": 50,
    "RTL_ALT": 1500,
    "RTL_LOIT_TIME": 5000,
    "WPNAV_ACCEL": 250,
    "WPNAV_ACCEL_Z": 100,
    "WPNAV_SPEED": 1000,
    "WPNAV_SPEED_DN": 150,
    "WPNAV_SPEED_UP": 250,
}
ROVER_PARAMETERS: Mapping[str, float] = {
    **COMMON,
    "ATC_ACCEL_MAX": 1.0,
    "CRUISE_SPEED": 5,
    "FS_ACTION": 2,
    "FS_TIMEOUT": 1.5,
    "WP_ACCEL": 0,
    "WP_SPEED": 5,
}

#: MAV_MODE_FLAG: custom, manual, stabilised, guided. A copter marks every mode as manual.
_CUSTOM, _MANUAL, _LEVELLED, _GUIDED = 1, 64, 16, 8
_FLOWN = _CUSTOM | _MANUAL | _LEVELLED

ACKERMANN = VehicleKind(
    "rover",
    10,
    ROVER_FLAVOUR,
    {
        "MANUAL": FlightMode(0, Role.MANUAL, _CUSTOM | _MANUAL, by_hand=True),
        "ACRO": FlightMode(1, Role.MANUAL, _CUSTOM | _MANUAL, by_hand=True),
        "STEERING": FlightMode(3, Role.MANUAL, _CUSTOM | _MANUAL, by_hand=True),
        "HOLD": FlightMode(4, Role.HOLD, _CUSTOM, by_hand=True),
        "LOITER": FlightMode(5, Role.HOLD, _CUSTOM | _GUIDED),
        "AUTO": FlightMode(10, Role.MISSION, _CUSTOM | _GUIDED),
        "RTL": FlightMode(11, Role.RETURN, _CUSTOM | _GUIDED, armable=False),
        "SMART_RTL": FlightMode(12, Role.RETURN, _CUSTOM | _GUIDED, armable=False),
        "GUIDED": FlightMode(15, Role.GUIDED, _CUSTOM | _GUIDED),
    },
    "MANUAL",
    ROVER_PARAMETERS,
    {"cruise": ("WP_SPEED", 1.0), "acceleration": ("ATC_ACCEL_MAX", 1.0)},
    RoverSpeedControl,
    ROVER_WARMING,
    # A rover overshoots its speed: 2.20 of 2 and 3.44 of 3 m/s, for a second or two (ap-rover.deaths-34).
    Limits(braking=1.0, jerk=2.0, overshoot=0.43, overshoot_share=0.05, rolls_out=0.5),
    wheels=Wheels(1.4),
    home_altitude=0.19,
    lands=False,
)

KINDS = {
    "copter": VehicleKind(
        "copter",
        2,
        COPTER_FLAVOUR,
        {
            "STABILIZE": FlightMode(0, Role.MANUAL, _FLOWN, by_hand=True),
            "ACRO": FlightMode(1, Role.MANUAL, _FLOWN, by_hand=True),
            "ALT_HOLD": FlightMode(2, Role.MANUAL, _FLOWN, by_hand=True),
            "AUTO": FlightMode(3, Role.MISSION, _FLOWN | _GUIDED, armable=False),
            "GUIDED": FlightMode(4, Role.GUIDED, _FLOWN | _GUIDED),
            # Before LOITER: ArduCopter's fallback for a hold.
            "BRAKE": FlightMode(17, Role.HOLD, _FLOWN | _GUIDED, armable=False),
            "LOITER": FlightMode(5, Role.HOLD, _FLOWN | _GUIDED, by_hand=True),
            "RTL": FlightMode(6, Role.RETURN, _FLOWN | _GUIDED, armable=False),
            "CIRCLE": FlightMode(7, Role.ORBIT, _FLOWN | _GUIDED, armable=False),
            "LAND": FlightMode(9, Role.LAND, _FLOWN | _GUIDED, armable=False),
            "POSHOLD": FlightMode(16, Role.HOLD, _FLOWN | _GUIDED, by_hand=True),
        },
        "STABILIZE",
        COPTER_PARAMETERS,
        {
            "cruise": ("WPNAV_SPEED", 100.0),
            "climb": ("WPNAV_SPEED_UP", 100.0),
            "descend": ("WPNAV_SPEED_DN", 100.0),
            "land": ("LAND_SPEED", 100.0),
            "acceleration": ("WPNAV_ACCEL", 100.0),
            "vertical_acceleration": ("WPNAV_ACCEL_Z", 100.0),
            "tilt": ("ANGLE_MAX", CENTIDEGREES),
        },
        CopterSpeedControl,
        COPTER_WARMING,
        # A copter flies 3.06 of 3 m/s in still air (ap-copter.c-speed).
        Limits(
            braking=2.5,
            jerk=5.0,
            eases=0.8,
            spool=0.6,
            awake=3.3,
            lift=1.0,
            takeoff=2.5,
            goal_response=Response(1.02),
        ),
        # Missions have low jerk, GUIDED goes straight to its goal.
        mission_limits={"braking": 1.25, "jerk": 1.5},
        return_height=("RTL_ALT", 100.0),
        return_pause=("RTL_LOIT_TIME", 1000.0),
    ),
    "rover": ACKERMANN,
    "rover_skid": replace(ACKERMANN, wheels=Wheels()),
}
