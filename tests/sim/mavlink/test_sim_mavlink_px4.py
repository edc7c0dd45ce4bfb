"""The fake as PX4: what differs from ArduPilot, by raw packets and given time."""

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
    """Stream a velocity for a while, having asked for the mode when there was a stream."""
    for _ in range(3):
        c.target(VELOCITY, velocity=velocity)
        c.wait(0.06)
    result = c.command(MODE, 1, *OFFBOARD)
    for _ in range(round(seconds / 0.1)):
        c.target(VELOCITY, velocity=velocity)
        c.wait(0.1)
    return result


def test_it_holds_at_the_height_of_its_takeoff():
    c = px4()
    up(c, height=2.0)
    assert c.autopilot.vehicle.place[2] == pytest.approx(-2.0, abs=0.02)
    c.messages.clear()
    c.wait(60.0)
    told = {m.altitude for m in c.messages if m.get_type() == "HOME_POSITION"}
    assert len(told) > 20
    assert 1.0 < (max(told) - min(told)) / 1000 < 3.0, "home moves with GNSS, the vehicle does not"
    assert c.autopilot.vehicle.place[2] == pytest.approx(-2.0, abs=0.02)


def test_it_streams_at_once():
    heard = {m.get_type() for m in px4().wait(3.0)}
    assert {"ATTITUDE", "GLOBAL_POSITION_INT", "SYS_STATUS", "EXTENDED_SYS_STATE", "HOME_POSITION"} <= heard


def test_the_heartbeat_is_px4s():
    c = px4()
    beat = next(m for m in c.wait(1.0) if m.get_type() == "HEARTBEAT")
    assert (beat.autopilot, beat.type) == (12, 2)
    assert (beat.custom_mode >> 16 & 0xFF, beat.custom_mode >> 24) == LOITER
    assert c.ask(148).capabilities & 0x10


def test_a_default_rate_comes_back():
    c = px4()
    assert c.command(STREAM, 30, -1) == ACCEPTED
    assert not [m for m in c.wait(1.0) if m.get_type() == "ATTITUDE"]
    assert c.command(STREAM, 30, 0) == ACCEPTED
    assert 49 <= len([m for m in c.wait(1.0) if m.get_type() == "ATTITUDE"]) <= 51


def test_takeoff_to_the_height_of_the_parameter_then_hold():
    c = px4()
    up(c, 6.0)
    assert -c.place[2] == pytest.approx(6.0, abs=0.4)
    assert c.autopilot.mode == "AUTO.LOITER"


def test_takeoff_while_disarmed_is_accepted_and_nothing_happens():
    c = px4()
    assert c.command(TAKEOFF, *[NAN] * 7) == ACCEPTED
    c.wait(5.0)
    assert not c.autopilot.armed
    assert c.place[2] == 0.0


def test_a_refused_arming_says_why_in_texts_of_more_than_one_chunk():
    c = px4(refuse_arming="compass uncalibrated")
    assert c.command(ARM, 1) == REJECTED
    c.wait(0.1)
    assert c.texts() == [
        "Preflight Fail: compass uncalibrated\t",
        "Arming denied: Resolve system health failures firs",
        "t\t",
    ]


def test_it_needs_some_seconds_after_a_start():
    c = px4(warm_up=10.0)
    assert c.command(ARM, 1) == REJECTED
    assert not c.ask(1).onboard_control_sensors_health & 0x10000000
    c.wait(0.1)
    assert c.texts() == [], "at first it refuses without a word"
    c.wait(5.0)
    assert c.command(ARM, 1) == REJECTED
    c.wait(5.0)
    assert "Arming denied: Resolve system health failures firs" in c.texts()
    assert c.command(ARM, 1) == ACCEPTED
    health = c.ask(1)
    assert health.onboard_control_sensors_health & 0x10000000
    assert not health.onboard_control_sensors_present & 0x10000000


def test_other_components_hear_nothing():
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
def test_what_it_does_not_know(number, values, result):
    assert px4().command(number, *values) == result


def test_offboard_without_setpoints_is_accepted_and_not_entered():
    c = px4()
    up(c)
    assert c.command(MODE, 1, *OFFBOARD) == ACCEPTED
    c.wait(1.0)
    assert c.autopilot.mode == "AUTO.LOITER"
    assert "Switching to Offboard is currently not available\t" in c.texts()


def test_offboard_with_setpoints_and_what_happens_when_they_end():
    c = px4()
    up(c)
    assert c.command(STREAM, 0, 200_000) == FAILED, "its heartbeat comes once a second"
    assert c.command(STREAM, 436, 200_000) == ACCEPTED
    assert offboard(c, 2.0) == ACCEPTED
    assert c.autopilot.mode == "OFFBOARD"
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.6, abs=0.07), "2 m/s were asked for"
    c.messages.clear()
    c.wait(0.9)
    assert c.autopilot.mode == "OFFBOARD"
    c.wait(0.4)
    assert c.autopilot.mode == "AUTO.RTL"
    c.wait(1.0)
    assert "Failsafe activated\t" in c.texts()
    told = [(m.custom_mode, m.intended_custom_mode) for m in c.messages if m.get_type() == "CURRENT_MODE"][-1]
    assert told == (5 << 24 | 4 << 16, 6 << 16), "what was commanded stays, whatever the failsafe made of it"
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 5
    assert c.command(MODE, 1, *LOITER) == ACCEPTED
    c.wait(1.1)
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 4


def test_offboard_lifts_off_by_setpoints():
    c = px4()
    offboard(c, 0.1, (0, 0, -1))
    c.command(ARM, 1)
    offboard(c, 6.0, (0, 0, -1))
    assert c.place[2] < -2.0
    assert "Takeoff detected\t" in c.texts()


def test_the_data_link_failsafe_holds_then_acts():
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
    assert lost not in c.texts(), "without a station it says nothing"
    c.heartbeat()
    c.wait(0.1)
    assert lost in c.texts()


def test_only_ground_stations_feed_the_data_link():
    c = px4(beats=False)
    up(c)
    c.heartbeat()
    c.autopilot.parameters.update({"NAV_DLL_ACT": 2, "COM_DL_LOSS_T": 5})
    for _ in range(7):
        c.wait(1.0)
        c.heartbeat(kind=18)
    assert c.autopilot.critical


def test_the_distance_fence_holds():
    c = px4()
    c.autopilot.parameters["GF_MAX_HOR_DIST"] = 10
    up(c)
    offboard(c, 10.0, (3, 0, 0))
    assert c.autopilot.mode == "AUTO.LOITER"
    assert any(text.startswith("Geofence: exceeding maximum distance") for text in c.texts())
    assert c.command(ONCE, 162) == DENIED, "PX4 tells its fence in words only"


def test_orbit():
    c = px4()
    up(c)
    here = c.ask(33)
    assert c.command_int(34, 5.0, 2.0, 0, NAN, x=here.lat, y=here.lon, z=NAN, frame=5) == ACCEPTED
    c.wait(8.0)
    seen = []
    for _ in range(100):
        c.wait(0.1)
        seen.append(math.hypot(*c.place[:2]))
    assert min(seen) > 4.0
    assert max(seen) < 6.0
    assert c.autopilot.mode == "POSCTL.ORBIT"


def test_reposition_holds_there():
    c = px4()
    up(c)
    lat, lon = c.fake.place.at(10.0, 5.0)
    assert c.command_int(192, -1, 0, 0, NAN, x=lat, y=lon, z=c.fake.place.altitude + 6) == ACCEPTED
    c.wait(8.0)
    assert math.dist(c.place, (10, 5, -6)) < 0.3
    assert c.autopilot.mode == "AUTO.LOITER"


def test_landing_and_disarming_two_seconds_later():
    c = px4()
    up(c)
    c.command(MODE, 1, *LANDING)
    while not c.autopilot.landed:
        c.wait(0.1)
    c.wait(1.5)
    assert c.autopilot.armed
    c.wait(1.0)
    assert not c.autopilot.armed


def test_disarming_in_the_air_is_refused():
    c = px4()
    up(c)
    assert c.command(ARM, 0) == REJECTED
    c.wait(0.1)
    assert "Disarming denied: not landed\t" in c.texts()


def test_a_reboot_is_silent_for_a_moment_and_forgets():
    c = px4()
    c.command(STREAM, 30, -1)
    assert c.command(246, 1) == ACCEPTED
    assert c.wait(2.5) == []
    assert c.command(ARM, 1) is None
    heard = c.wait(2.0)
    assert "ATTITUDE" in {m.get_type() for m in heard}
    assert c.ask(2).time_boot_ms < 3000
    c.command(ARM, 1)
    assert c.command(246, 1) == DENIED


def test_a_slow_command_is_in_progress_first():
    c = px4(faults=["slow_acks=2"])
    assert c.command(RTL) == IN_PROGRESS
    c.messages.clear()
    c.wait(1.0)
    assert c.command(RTL) == IN_PROGRESS, "a repetition is not carried out again"
    c.wait(1.1)
    (done,) = [m for m in c.messages if m.get_type() == "COMMAND_ACK" and m.result != IN_PROGRESS]
    assert (done.command, done.result, done.target_system) == (RTL, ACCEPTED, 255)


def test_the_battery_failsafe():
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


def test_a_rover_takes_off_and_lands_in_words():
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


def test_a_rover_drives_faster_than_it_is_told_and_disarms_at_home():
    c = px4("rover")
    c.command(ARM, 1)
    offboard(c, 5.0, (1, 0, 0))
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.45, abs=0.05), "1 m/s was asked for"
    assert c.command(YAW, 90) == UNSUPPORTED
    assert c.command(RTL) == ACCEPTED
    c.wait(25.0)
    assert math.hypot(*c.place[:2]) < 0.6
    assert not c.autopilot.armed
    assert c.autopilot.mode == "AUTO.LOITER"


def test_a_mode_that_is_not_available_is_accepted_and_refused_in_words():
    c = px4()
    up(c)
    for number, text in (((4, 4), "Mission"), ((2, 0), "Altitude")):
        assert c.command(MODE, 1, *number) == ACCEPTED
        c.wait(0.1)
        assert f"Switching to {text} is currently not available\t" in c.texts()
    assert c.command(MODE, 1, 99) == ACCEPTED
    assert c.autopilot.mode == "AUTO.LOITER"
    assert Client().command(MODE, 1, 3) == FAILED


def test_the_origin_is_told_to_the_first_that_is_heard_and_no_stream():
    c = Client(flavour="px4")
    c.wait(1.0)
    assert "GPS_GLOBAL_ORIGIN" not in {m.get_type() for m in c.messages}
    assert c.command(STREAM, 49, 200_000) == ACCEPTED
    c.wait(3.0)
    assert len([m for m in c.messages if m.get_type() == "GPS_GLOBAL_ORIGIN"]) == 1
    assert c.ask(49)
