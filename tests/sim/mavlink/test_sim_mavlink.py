"""The MAVLink fake by raw packets and given time: no sockets, no sleeping, no driver."""

from __future__ import annotations

import math

import pytest
from mavlink_client import (
    ACCEPTED,
    ARM,
    BRAKE,
    DENIED,
    FAILED,
    GUIDED,
    LAND,
    MODE,
    ONCE,
    RTL,
    SPEED,
    STREAM,
    TAKEOFF,
    UNSUPPORTED,
    YAW,
    Client,
)
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import FLAVOURS
from lfield_sim.autopilot.equipment.payload import Battery
from lfield_sim.mavlink.telemetry.message_table import MESSAGES


def kinds(messages) -> set[str]:
    return {m.get_type() for m in messages}


def test_nothing_but_heartbeats_until_asked():
    c = Client()
    heard = c.wait(5.0)
    # One TIMESYNC in 10 s.
    assert kinds(heard) == {"HEARTBEAT", "TIMESYNC"}
    assert len(heard) == 6
    beat = heard[0]
    assert (beat.type, beat.autopilot, beat.get_srcComponent()) == (2, 3, 1)
    assert beat.base_mode & 1
    assert beat.get_msgbuf()[0] == 0xFD, "MAVLink 2"


def test_streams_at_the_rate_asked_for_and_stopped():
    c = Client()
    assert c.command(STREAM, 32, 100_000) == ACCEPTED
    heard = [m for m in c.wait(2.0) if m.get_type() == "LOCAL_POSITION_NED"]
    assert 19 <= len(heard) <= 21
    assert c.command(STREAM, 32, -1) == ACCEPTED
    assert kinds(c.wait(2.0)) == {"HEARTBEAT"}
    assert c.command(STREAM, 9999, 100_000) == DENIED


def test_the_old_way_to_ask_for_streams():
    c = Client()
    c.send(dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    assert {"GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS", "VFR_HUD", "GPS_RAW_INT"} <= kinds(c.wait(1.0))
    c.send(dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 0))
    assert kinds(c.wait(2.0)) == {"HEARTBEAT"}


@pytest.mark.parametrize("kind", sorted(MESSAGES.keys() - {436}))
def test_every_message_can_be_asked_for_once(kind):
    flavour = "px4" if kind in FLAVOURS["ardupilot"]["copter"].flavour.lacks else "ardupilot"
    c = Client(flavour=flavour)
    c.autopilot.parameters |= {"FENCE_ENABLE": 1, "EKF2_DRAG_CTRL": 1}
    targets = (
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    )
    if kind in targets:
        # They are sent only while the vehicle goes to a place.
        c.up()
        goal = (5.0, 0.0, -5.0, *[0.0] * 8)
        c.send(dialect.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x0DF8, *goal))
        c.messages.clear()
    assert c.command(ONCE, kind) == ACCEPTED
    assert c.messages[-1].get_msgId() == kind
    assert c.command(510, kind) == ACCEPTED
    assert c.messages[-1].get_type() == "MESSAGE_INTERVAL"


@pytest.mark.parametrize(
    ("prepare", "number", "values", "result", "text"),
    [
        ("", 31337, (), UNSUPPORTED, ""),
        ("", TAKEOFF, (0, 0, 0, 0, 0, 0, 5), FAILED, ""),
        ("arm", TAKEOFF, (0, 0, 0, 0, 0, 0, 5), FAILED, ""),
        ("up", TAKEOFF, (0, 0, 0, 0, 0, 0, 5), FAILED, ""),
        ("up", ARM, (1,), ACCEPTED, ""),
        ("up", ARM, (0,), FAILED, ""),
        ("up", ARM, (0, 21196), ACCEPTED, ""),
        ("brake", ARM, (1,), FAILED, "Arm: BRAKE mode not armable"),
        ("", MODE, (1, 99), FAILED, "No such mode 99"),
        ("", MODE, (0, 4), DENIED, ""),
        ("up", YAW, (400, 0, 0, 0), FAILED, ""),
        ("up", SPEED, (1, -3), DENIED, ""),
        ("up", SPEED, (2, 3), UNSUPPORTED, ""),
        ("", ONCE, (9999,), FAILED, ""),
    ],
)
def test_refusals(prepare, number, values, result, text):
    c = Client()
    if prepare == "arm":
        c.command(ARM, 1)
    elif prepare == "brake":
        c.command(MODE, 1, BRAKE)
    elif prepare == "up":
        c.up()
    c.messages.clear()
    assert c.command(number, *values) == result
    c.wait(0.1)
    assert not text or text in c.texts()


def test_other_systems_are_left_alone_and_other_components_served():
    c = Client()
    assert c.command(MODE, 1, GUIDED, target=2) is None
    assert c.command(MODE, 1, GUIDED, component=42) == ACCEPTED


def test_a_long_text_comes_in_chunks():
    reason = "the compass and the accelerometers disagree about where is down, says the pilot"
    c = Client(refuse_arming=reason)
    assert c.command(ARM, 1) == FAILED
    c.wait(0.1)
    chunks = [m for m in c.messages if m.get_type() == "STATUSTEXT"]
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert len({m.id for m in chunks}) == 1
    assert "".join(m.text for m in chunks) == f"Arm: {reason}"


def test_a_flight_by_packets():
    c = Client()
    c.up(5.0)
    assert c.place[2] == pytest.approx(-5.0, abs=0.1)
    c.target(0x0DF8, place=(10, 4, -6))
    c.wait(10.0)
    assert math.dist(c.place, (10, 4, -6)) < 0.1
    assert c.command(YAW, 270) == ACCEPTED
    c.wait(5.0)
    assert c.autopilot.vehicle.yaw == pytest.approx(-math.pi / 2, abs=0.01)
    assert c.command(LAND) == ACCEPTED
    c.wait(16.0)
    assert c.place[2] == 0.0
    assert not c.autopilot.armed, "it disarms itself after landing"


def test_speeds_are_limited():
    c = Client()
    c.up(5.0)
    c.target(0x0DF8, place=(60, 0, -5))
    fastest = max(c.autopilot.vehicle.velocity[0] for _ in range(250) if c.wait(0.02) is not None)
    assert fastest == pytest.approx(10.0, abs=0.3)
    assert c.command(SPEED, 1, 2.0) == ACCEPTED
    c.target(0x0DF8, place=(120, 0, -5))
    c.wait(5.0)
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(2.04, abs=0.01)


def test_a_velocity_setpoint_ends_by_itself():
    c = Client()
    c.up()
    c.target(0x0DC7, velocity=(2, 0, 0))
    c.wait(2.5)
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.9, abs=0.1), "it comes to it gently"
    c.wait(4.0)
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(0.0, abs=0.01)
    assert c.autopilot.mode == "GUIDED"


def test_setpoints_on_the_ground_and_outside_guided_are_ignored():
    c = Client()
    c.command(MODE, 1, GUIDED)
    c.command(ARM, 1)
    c.target(0x0DF8, place=(10, 0, -5))
    c.wait(3.0)
    assert c.place == (0.0, 0.0, 0.0)
    c = Client()
    c.up()
    c.command(MODE, 1, BRAKE)
    c.target(0x0DF8, place=(10, 0, -5))
    c.wait(3.0)
    assert abs(c.place[0]) < 0.1


def test_armed_and_forgotten_it_disarms():
    c = Client()
    c.command(ARM, 1)
    c.wait(11.0)
    assert not c.autopilot.armed


def test_the_gcs_failsafe():
    c = Client()
    c.send(dialect.MAVLink_param_set_message(1, 1, b"FS_GCS_TIMEOUT", 3, 9))
    c.up()
    c.send(dialect.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 1, 9))
    c.heartbeat()
    c.wait(2.9)
    assert c.autopilot.mode == "GUIDED"
    c.wait(0.2)
    assert c.autopilot.mode == "RTL"
    assert "GCS Failsafe" in c.texts()
    c.wait(1.0)
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 5
    c.heartbeat()
    c.wait(0.3)
    assert "GCS Failsafe Cleared" not in c.texts()
    c.wait(0.1)
    assert "GCS Failsafe Cleared" in c.texts()
    assert c.autopilot.mode == "RTL"


def test_heartbeats_of_another_station_do_not_count():
    c = Client(sender=254)
    c.autopilot.parameters["FS_GCS_ENABLE"] = 1
    c.heartbeat()
    c.autopilot.arm()
    c.wait(8.0)
    assert "GCS Failsafe" not in c.texts()


def test_without_the_parameter_there_is_no_failsafe():
    c = Client()
    c.heartbeat()
    c.up()
    c.wait(20.0)
    assert c.autopilot.mode == "GUIDED"


def test_return_to_launch_climbs_comes_home_and_lands():
    c = Client()
    c.up()
    c.target(0x0DF8, place=(20, 0, -5))
    c.wait(10.0)
    assert c.command(RTL) == ACCEPTED
    c.wait(8.0)
    assert c.place[2] < -10.0
    c.wait(40.0)
    assert math.dist(c.place, (0, 0, 0)) < 0.5
    assert not c.autopilot.armed


def parameter(c, message):
    """What is told for a message about a parameter, at once or a moment later; None for nothing."""
    told = [m for m in [*c.send(message), *c.wait(0.3)] if m.get_type() == "PARAM_VALUE"]
    return told[0] if told else None


def test_parameters():
    c = Client()
    answer = parameter(c, dialect.MAVLink_param_request_read_message(1, 1, b"FS_GCS_ENABLE", -1))
    assert (answer.param_id, answer.param_value) == ("FS_GCS_ENABLE", 0.0)
    assert parameter(c, dialect.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)) is None
    assert parameter(c, dialect.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1, 9)) is None
    answer = parameter(c, dialect.MAVLink_param_set_message(1, 1, b"WPNAV_SPEED", 300, 9))
    assert answer.param_value == 300.0
    assert c.autopilot.own_speed() == 3.0
    c.send(dialect.MAVLink_param_request_list_message(1, 1))
    everything = [m for m in c.wait(3.0) if m.get_type() == "PARAM_VALUE"]
    assert {m.param_index for m in everything} == set(range(everything[0].param_count))
    assert parameter(c, dialect.MAVLink_param_request_read_message(1, 1, b"", 3)).param_index == 3


def test_the_battery_drains_faster_in_the_air_and_says_when_it_is_low():
    c = Client(battery=Battery(0.21))
    c.wait(60.0)
    on_ground = 0.21 - c.autopilot.battery.charge
    c.up()
    before = c.autopilot.battery.charge
    c.wait(60.0)
    assert before - c.autopilot.battery.charge > 10 * on_ground
    assert any(text.startswith("Battery 1 is low") for text in c.texts())


def test_an_empty_battery_lands():
    c = Client(battery=Battery(0.02))
    c.up(10.0)
    c.wait(60.0)
    assert c.place[2] == 0.0


def test_a_rover():
    c = Client("rover")
    assert c.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == UNSUPPORTED
    assert c.command(MODE, 1, 15) == ACCEPTED
    assert c.command(ARM, 1) == ACCEPTED
    c.target(0x0DF8, place=(5, 5, 0))
    c.wait(15.0)
    assert math.dist(c.place, (5, 5, 0)) < 0.2
    assert c.wait(1.0)[0].type == 10


def test_positions_agree():
    c = Client()
    c.up()
    c.target(0x0DF8, place=(30, 40, -5))
    c.wait(20.0)
    for kind in (242, 33, 32):
        c.command(ONCE, kind)
    home, globe, local = c.messages[-5], c.messages[-3], c.messages[-1]
    north = math.radians((globe.lat - home.latitude) / 1e7) * 6378137.0
    assert north == pytest.approx(local.x, abs=0.1)
    assert globe.relative_alt == pytest.approx(5000, abs=100)


def test_faults():
    c = Client(faults=["loss=0.5"])
    got = sum(1 for _ in range(200) if c.command(MODE, 1, GUIDED) is not None)
    assert 20 < got < 80, "a quarter of the questions are answered"
    c = Client()
    assert len([m for m in c.wait(2.9) if m.get_type() == "HEARTBEAT"]) == 3
    c.fault("silence=true")
    assert c.wait(3.0) == []
    assert c.command(MODE, 1, GUIDED) is None
