"""The MAVLink fake by raw packets in virtual time: no sockets, no driver."""

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


def test_ardupilot_sends_only_heartbeats_without_a_request():
    c = Client()
    received = c.wait(5.0)
    # One TIMESYNC in 10 s.
    assert kinds(received) == {"HEARTBEAT", "TIMESYNC"}
    assert len(received) == 6
    heartbeat = received[0]
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.get_srcComponent()) == (2, 3, 1)
    assert heartbeat.base_mode & 1
    assert heartbeat.get_msgbuf()[0] == 0xFD, "MAVLink 2"


def test_stream_has_the_requested_rate_and_stops():
    c = Client()
    assert c.command(STREAM, 32, 100_000) == ACCEPTED
    received = [m for m in c.wait(2.0) if m.get_type() == "LOCAL_POSITION_NED"]
    assert 19 <= len(received) <= 21
    assert c.command(STREAM, 32, -1) == ACCEPTED
    assert kinds(c.wait(2.0)) == {"HEARTBEAT"}
    assert c.command(STREAM, 9999, 100_000) == DENIED


def test_request_data_stream_starts_and_stops_streams():
    c = Client()
    c.send(dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    assert {"GLOBAL_POSITION_INT", "ATTITUDE", "SYS_STATUS", "VFR_HUD", "GPS_RAW_INT"} <= kinds(c.wait(1.0))
    c.send(dialect.MAVLink_request_data_stream_message(1, 1, 0, 4, 0))
    assert kinds(c.wait(2.0)) == {"HEARTBEAT"}


@pytest.mark.parametrize("kind", sorted(MESSAGES.keys() - {436}))
def test_every_message_can_be_requested_once(kind):
    flavour = "px4" if kind in FLAVOURS["ardupilot"]["copter"].flavour.unknown_messages else "ardupilot"
    c = Client(flavour=flavour)
    c.autopilot.parameters |= {"FENCE_ENABLE": 1, "EKF2_DRAG_CTRL": 1}
    targets = (
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_GLOBAL_INT,
        dialect.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED,
    )
    if kind in targets:
        # They are sent only while the vehicle flies to a goal.
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
def test_command_result_by_state(prepare, number, values, result, text):
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


def test_other_system_is_ignored_and_other_component_served():
    c = Client()
    assert c.command(MODE, 1, GUIDED, target=2) is None
    assert c.command(MODE, 1, GUIDED, component=42) == ACCEPTED


def test_long_status_text_is_sent_in_chunks():
    reason = "the compass and the accelerometers disagree about where is down, says the pilot"
    c = Client(refuse_arming=reason)
    assert c.command(ARM, 1) == FAILED
    c.wait(0.1)
    chunks = [m for m in c.messages if m.get_type() == "STATUSTEXT"]
    assert [m.chunk_seq for m in chunks] == [0, 1]
    assert len({m.id for m in chunks}) == 1
    assert "".join(m.text for m in chunks) == f"Arm: {reason}"


def test_flight_by_packets():
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
    assert not c.autopilot.armed, "it disarms after landing"


def test_copter_flies_its_default_and_set_speed():
    c = Client()
    c.up(5.0)
    c.target(0x0DF8, place=(60, 0, -5))
    fastest = max(c.autopilot.vehicle.velocity[0] for _ in range(250) if c.wait(0.02) is not None)
    assert fastest == pytest.approx(10.0, abs=0.3)
    assert c.command(SPEED, 1, 2.0) == ACCEPTED
    c.target(0x0DF8, place=(120, 0, -5))
    c.wait(5.0)
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(2.04, abs=0.01)


def test_velocity_setpoint_times_out():
    c = Client()
    c.up()
    c.target(0x0DC7, velocity=(2, 0, 0))
    c.wait(2.5)
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.9, abs=0.1), "it accelerates gradually"
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


def test_armed_copter_on_the_ground_disarms_after_a_timeout():
    c = Client()
    c.command(ARM, 1)
    c.wait(11.0)
    assert not c.autopilot.armed


def test_gcs_failsafe_returns_and_clears_after_heartbeats():
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


def test_heartbeats_of_another_station_are_ignored_in_flight():
    c = Client(sender=254)
    c.autopilot.parameters["FS_GCS_ENABLE"] = 1
    c.heartbeat()
    c.autopilot.arm()
    c.wait(8.0)
    assert "GCS Failsafe" not in c.texts()


def test_disabled_gcs_failsafe_does_not_act():
    c = Client()
    c.heartbeat()
    c.up()
    c.wait(20.0)
    assert c.autopilot.mode == "GUIDED"


def test_return_to_launch_climbs_returns_and_lands():
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


def test_battery_drains_faster_in_flight_and_reports_low_charge():
    c = Client(battery=Battery(0.21))
    c.wait(60.0)
    on_ground = 0.21 - c.autopilot.battery.charge
    c.up()
    before = c.autopilot.battery.charge
    c.wait(60.0)
    assert before - c.autopilot.battery.charge > 10 * on_ground
    assert any(text.startswith("Battery 1 is low") for text in c.texts())


def test_empty_battery_leads_to_a_landing():
    c = Client(battery=Battery(0.02))
    c.up(10.0)
    c.wait(60.0)
    assert c.place[2] == 0.0


def test_rover_refuses_takeoff_and_drives_to_a_goal():
    c = Client("rover")
    assert c.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == UNSUPPORTED
    assert c.command(MODE, 1, 15) == ACCEPTED
    assert c.command(ARM, 1) == ACCEPTED
    c.target(0x0DF8, place=(5, 5, 0))
    c.wait(15.0)
    assert math.dist(c.place, (5, 5, 0)) < 0.2
    assert c.wait(1.0)[0].type == 10


def test_global_and_local_positions_agree():
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


def test_loss_and_silence_faults():
    c = Client(faults=["loss=0.5"])
    got = sum(1 for _ in range(200) if c.command(MODE, 1, GUIDED) is not None)
    assert 20 < got < 80, "a quarter of the requests is answered"
    c = Client()
    assert len([m for m in c.wait(2.9) if m.get_type() == "HEARTBEAT"]) == 3
    c.fault("silence=true")
    assert c.wait(3.0) == []
    assert c.command(MODE, 1, GUIDED) is None
