"""The fake as PX4: differences from ArduPilot, by raw packets in virtual time."""

from __future__ import annotations

import math

import pytest
from mavlink_client import (
    ACCEPTED,
    ARM,
    DENIED,
    FAILED,
    IN_PROGRESS,
    MODE,
    ONCE,
    REJECTED,
    RTL,
    STREAM,
    TAKEOFF,
    UNSUPPORTED,
    YAW,
    Client,
)
from pymavlink.dialects.v20 import all as dialect

NAN = math.nan
OFFBOARD, LOITER, LANDING = (6, 0), (4, 3), (4, 6)
VELOCITY = 0x0DC7


def px4(kind="copter", *, beats=True, **options) -> Client:
    c = Client(kind, flavour="px4", beats=beats, **options)
    c.heartbeat()
    return c


def up(c: Client, height=4.0) -> None:
    c.autopilot.parameters["MIS_TAKEOFF_ALT"] = height
    assert c.command(ARM, 1) == ACCEPTED
    assert c.command(TAKEOFF, *[NAN] * 7) == ACCEPTED
    c.wait(5.0 + height)


def offboard(c: Client, seconds=0.0, velocity=(2, 0, 0)) -> int | None:
    """Streams a velocity for some seconds; requests the mode after the start of the stream."""
    for _ in range(3):
        c.target(VELOCITY, velocity=velocity)
        c.wait(0.06)
    result = c.command(MODE, 1, *OFFBOARD)
    for _ in range(round(seconds / 0.1)):
        c.target(VELOCITY, velocity=velocity)
        c.wait(0.1)
    return result


def test_takeoff_reaches_and_holds_the_height_of_the_parameter():
    c = px4()
    up(c, height=2.0)
    assert c.autopilot.vehicle.place[2] == pytest.approx(-2.0, abs=0.02)
    c.messages.clear()
    c.wait(60.0)
    altitudes = {m.altitude for m in c.messages if m.get_type() == "HOME_POSITION"}
    assert len(altitudes) > 20
    assert 1.0 < (max(altitudes) - min(altitudes)) / 1000 < 3.0, "home drifts with GNSS, the vehicle does not"
    assert c.autopilot.vehicle.place[2] == pytest.approx(-2.0, abs=0.02)


def test_px4_streams_without_a_request():
    received = {m.get_type() for m in px4().wait(3.0)}
    assert {
        "ATTITUDE",
        "GLOBAL_POSITION_INT",
        "SYS_STATUS",
        "EXTENDED_SYS_STATE",
        "HOME_POSITION",
    } <= received


def test_heartbeat_and_capabilities_are_those_of_px4():
    c = px4()
    heartbeat = next(m for m in c.wait(1.0) if m.get_type() == "HEARTBEAT")
    assert (heartbeat.autopilot, heartbeat.type) == (12, 2)
    assert (heartbeat.custom_mode >> 16 & 0xFF, heartbeat.custom_mode >> 24) == LOITER
    assert c.ask(148).capabilities & 0x10


def test_interval_0_restores_the_default_rate():
    c = px4()
    assert c.command(STREAM, 30, -1) == ACCEPTED
    assert not [m for m in c.wait(1.0) if m.get_type() == "ATTITUDE"]
    assert c.command(STREAM, 30, 0) == ACCEPTED
    assert 49 <= len([m for m in c.wait(1.0) if m.get_type() == "ATTITUDE"]) <= 51


def test_takeoff_while_disarmed_is_accepted_without_effect():
    c = px4()
    assert c.command(TAKEOFF, *[NAN] * 7) == ACCEPTED
    c.wait(5.0)
    assert not c.autopilot.armed
    assert c.place[2] == 0.0


def test_refused_arming_sends_its_reason_in_chunked_texts():
    c = px4(refuse_arming="compass uncalibrated")
    assert c.command(ARM, 1) == REJECTED
    c.wait(0.1)
    assert c.texts() == [
        "Preflight Fail: compass uncalibrated\t",
        "Arming denied: Resolve system health failures firs",
        "t\t",
    ]


def test_arming_is_refused_during_the_warm_up():
    c = px4(warm_up=10.0)
    assert c.command(ARM, 1) == REJECTED
    assert not c.ask(1).onboard_control_sensors_health & 0x10000000
    c.wait(0.1)
    assert c.texts() == [], "at first it refuses without a text"
    c.wait(5.0)
    assert c.command(ARM, 1) == REJECTED
    c.wait(5.0)
    assert "Arming denied: Resolve system health failures firs" in c.texts()
    assert c.command(ARM, 1) == ACCEPTED
    health = c.ask(1)
    assert health.onboard_control_sensors_health & 0x10000000
    assert not health.onboard_control_sensors_present & 0x10000000


def test_other_component_gets_no_answer():
    assert px4().command(ARM, 1, component=42) is None


@pytest.mark.parametrize(
    ("number", "values", "result"),
    [
        (31337, (), UNSUPPORTED),
        (YAW, (90,), UNSUPPORTED),
        (183, (1, 1500), UNSUPPORTED),
        (ONCE, (9999,), DENIED),
    ],
)
def test_unknown_command_result(number, values, result):
    assert px4().command(number, *values) == result


def test_offboard_without_setpoints_is_accepted_and_not_entered():
    c = px4()
    up(c)
    assert c.command(MODE, 1, *OFFBOARD) == ACCEPTED
    c.wait(1.0)
    assert c.autopilot.mode == "AUTO.LOITER"
    assert "Switching to Offboard is currently not available\t" in c.texts()


def test_offboard_failsafe_acts_when_setpoints_end():
    c = px4()
    up(c)
    assert c.command(STREAM, 0, 200_000) == FAILED, "its heartbeat rate is fixed at 1 Hz"
    assert c.command(STREAM, 436, 200_000) == ACCEPTED
    assert offboard(c, 2.0) == ACCEPTED
    assert c.autopilot.mode == "OFFBOARD"
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.6, abs=0.07), "2 m/s were commanded"
    c.messages.clear()
    c.wait(0.9)
    assert c.autopilot.mode == "OFFBOARD"
    c.wait(0.4)
    assert c.autopilot.mode == "AUTO.RTL"
    c.wait(1.0)
    assert "Failsafe activated\t" in c.texts()
    modes = [(m.custom_mode, m.intended_custom_mode) for m in c.messages if m.get_type() == "CURRENT_MODE"][
        -1
    ]
    assert modes == (5 << 24 | 4 << 16, 6 << 16), "the intended mode stays the commanded one"
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 5
    assert c.command(MODE, 1, *LOITER) == ACCEPTED
    c.wait(1.1)
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 4


def test_offboard_setpoints_lift_off():
    c = px4()
    offboard(c, 0.1, (0, 0, -1))
    c.command(ARM, 1)
    offboard(c, 6.0, (0, 0, -1))
    assert c.place[2] < -2.0
    assert "Takeoff detected\t" in c.texts()


def test_data_link_failsafe_holds_then_acts():
    c = px4(beats=False)
    up(c)
    c.heartbeat()
    c.autopilot.parameters.update({"NAV_DLL_ACT": 2, "COM_DL_LOSS_T": 5})
    c.wait(6.4)
    assert not c.autopilot.critical
    c.wait(0.3)
    assert c.autopilot.critical
    assert c.autopilot.mode == "AUTO.LOITER"
    c.wait(5.0)
    assert c.autopilot.mode == "AUTO.RTL"
    lost = "Failsafe activated\t"
    assert lost not in c.texts(), "without a station it sends no text"
    c.heartbeat()
    c.wait(0.1)
    assert lost in c.texts()


def test_only_ground_station_heartbeats_keep_the_data_link():
    c = px4(beats=False)
    up(c)
    c.heartbeat()
    c.autopilot.parameters.update({"NAV_DLL_ACT": 2, "COM_DL_LOSS_T": 5})
    for _ in range(7):
        c.wait(1.0)
        c.heartbeat(kind=18)
    assert c.autopilot.critical


def test_distance_fence_breach_holds():
    c = px4()
    c.autopilot.parameters["GF_MAX_HOR_DIST"] = 10
    up(c)
    offboard(c, 10.0, (3, 0, 0))
    assert c.autopilot.mode == "AUTO.LOITER"
    assert any(text.startswith("Geofence: exceeding maximum distance") for text in c.texts())
    assert c.command(ONCE, 162) == DENIED, "PX4 reports its fence only by text"


@pytest.mark.few(0)
def test_orbit_keeps_its_radius():
    c = px4()
    up(c)
    here = c.ask(33)
    assert c.command_int(34, 5.0, 2.0, 0, NAN, x=here.lat, y=here.lon, z=NAN, frame=5) == ACCEPTED
    c.wait(8.0)
    distances = []
    for _ in range(100):
        c.wait(0.1)
        distances.append(math.hypot(*c.place[:2]))
    assert min(distances) > 4.0
    assert max(distances) < 6.0
    assert c.autopilot.mode == "POSCTL.ORBIT"


def test_reposition_holds_at_its_goal():
    c = px4()
    up(c)
    lat, lon = c.fake.place.at(10.0, 5.0)
    assert c.command_int(192, -1, 0, 0, NAN, x=lat, y=lon, z=c.fake.place.altitude + 6) == ACCEPTED
    c.wait(8.0)
    assert math.dist(c.place, (10, 5, -6)) < 0.3
    assert c.autopilot.mode == "AUTO.LOITER"


def test_disarming_in_the_air_is_refused():
    c = px4()
    up(c)
    assert c.command(ARM, 0) == REJECTED
    c.wait(0.1)
    assert "Disarming denied: not landed\t" in c.texts()


def test_reboot_is_silent_and_restores_defaults():
    c = px4()
    c.command(STREAM, 30, -1)
    assert c.command(246, 1) == ACCEPTED
    assert c.wait(2.5) == []
    assert c.command(ARM, 1) is None
    received = c.wait(2.0)
    assert "ATTITUDE" in {m.get_type() for m in received}
    assert c.ask(2).time_boot_ms < 3000
    c.command(ARM, 1)
    assert c.command(246, 1) == DENIED


def test_slow_command_reports_in_progress_first():
    c = px4(faults=["slow_acks=2"])
    assert c.command(RTL) == IN_PROGRESS
    c.messages.clear()
    c.wait(1.0)
    assert c.command(RTL) == IN_PROGRESS, "a repetition is not carried out again"
    c.wait(1.1)
    (done,) = [m for m in c.messages if m.get_type() == "COMMAND_ACK" and m.result != IN_PROGRESS]
    assert (done.command, done.result, done.target_system) == (RTL, ACCEPTED, 255)


def test_battery_failsafe_by_charge():
    c = px4(faults=["battery=0.2"])
    c.autopilot.parameters["COM_LOW_BAT_ACT"] = 3
    up(c)
    c.fault("battery=0.1")
    c.wait(0.2)
    assert "Low battery level! Return advised" in c.texts()
    assert c.autopilot.mode == "AUTO.LOITER"
    c.fault("battery=0.06")
    c.wait(0.2)
    assert c.autopilot.mode == "AUTO.RTL"
    c.fault("battery=0.04")
    c.wait(0.2)
    assert c.autopilot.mode == "AUTO.LAND"


def test_rover_reports_takeoff_and_landing_by_texts():
    """Trace l-px4-rover."""
    c = px4("rover")
    assert c.command(ARM, 1) == ACCEPTED
    c.wait(0.4)
    assert c.ask(245).landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
    assert c.command(TAKEOFF, *[NAN] * 7) == ACCEPTED
    c.wait(0.3)
    assert c.autopilot.mode == "AUTO.LOITER"
    assert c.ask(245).landed_state == dialect.MAV_LANDED_STATE_IN_AIR
    assert c.command(21, *[NAN] * 7) == ACCEPTED
    c.wait(0.5)
    assert c.autopilot.mode == "AUTO.LAND"
    assert c.ask(245).landed_state == dialect.MAV_LANDED_STATE_ON_GROUND
    assert {"Takeoff detected\t", "Landing at current position\t", "Landing detected\t"} <= set(c.texts())
    assert c.autopilot.armed
    c.wait(2.0)
    assert not c.autopilot.armed
    assert c.autopilot.mode == "AUTO.LOITER"


@pytest.mark.few(0)
def test_rover_drives_faster_than_commanded_and_disarms_at_home():
    c = px4("rover")
    c.command(ARM, 1)
    offboard(c, 5.0, (1, 0, 0))
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.45, abs=0.05), "1 m/s was commanded"
    assert c.command(YAW, 90) == UNSUPPORTED
    assert c.command(RTL) == ACCEPTED
    c.wait(25.0)
    assert math.hypot(*c.place[:2]) < 0.6
    assert not c.autopilot.armed
    assert c.autopilot.mode == "AUTO.LOITER"


def test_unavailable_mode_is_accepted_and_refused_by_text():
    c = px4()
    up(c)
    for number, text in (((4, 4), "Mission"), ((2, 0), "Altitude")):
        assert c.command(MODE, 1, *number) == ACCEPTED
        c.wait(0.1)
        assert f"Switching to {text} is currently not available\t" in c.texts()
    assert c.command(MODE, 1, 99) == ACCEPTED
    assert c.autopilot.mode == "AUTO.LOITER"
    assert Client().command(MODE, 1, 3) == FAILED


def test_origin_is_sent_once_and_has_no_stream():
    c = Client(flavour="px4")
    c.wait(1.0)
    assert "GPS_GLOBAL_ORIGIN" not in {m.get_type() for m in c.messages}
    assert c.command(STREAM, 49, 200_000) == ACCEPTED
    c.wait(3.0)
    assert len([m for m in c.messages if m.get_type() == "GPS_GLOBAL_ORIGIN"]) == 1
    assert c.ask(49)
