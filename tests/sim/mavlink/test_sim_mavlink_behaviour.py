"""Setpoints, payload, failsafes and faults of the fake, by raw packets in virtual time."""

from __future__ import annotations

import math

import pytest
from mavlink_client import ACCEPTED, ARM, DENIED, FAILED, GUIDED, MODE, STREAM, UNSUPPORTED, Client
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.link.radio_link import make_faults
from lfield_sim.mavlink.mavlink_fake import MavlinkFake, MavlinkLink

NAN = math.nan
POSITION, VELOCITY = 0x0DF8, 0x0DC7
HOME_POSITION, SET_HOME, CALIBRATE = 242, 179, 241


def test_yaw_rate_setpoint_turns_until_its_timeout():
    c = Client()
    c.up()
    message = dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0x05C7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.5
    )
    c.send(message)
    c.wait(2.0)
    assert c.autopilot.vehicle.yaw == pytest.approx(1.0, abs=0.05)
    assert c.ask(30).yawspeed == pytest.approx(0.5, abs=0.01)
    c.wait(5.0)
    assert c.autopilot.vehicle.yaw_rate == 0.0, "it ends with GUID_TIMEOUT"


def test_setpoints_in_body_and_offset_frames():
    c = Client()
    c.up()
    c.command(115, 90)
    c.wait(3.0)
    c.target(VELOCITY, velocity=(2, 0, 0), frame=8)
    c.wait(2.5)
    north, east, _ = c.autopilot.vehicle.velocity
    assert east == pytest.approx(1.9, abs=0.1)
    assert north == pytest.approx(0.0, abs=0.05)
    start = c.place
    c.target(POSITION, place=(3, 0, 0), frame=7)
    c.wait(5.0)
    assert c.place[0] == pytest.approx(start[0] + 3, abs=0.2)


def test_global_setpoint_is_reached():
    c = Client()
    c.up()
    lat, lon = c.fake.place.at(8.0, -6.0)
    zero = [0.0] * 8
    c.send(dialect.MAVLink_set_position_target_global_int_message(0, 1, 1, 6, POSITION, lat, lon, 7.0, *zero))
    c.wait(8.0)
    assert math.dist(c.place, (8, -6, -7)) < 0.2


def test_attitude_setpoint_tilts_and_climbs():
    c = Client()
    c.up()
    forward = [math.cos(-0.05), 0.0, math.sin(-0.05), 0.0]
    c.send(dialect.MAVLink_set_attitude_target_message(0, 1, 1, 0x07, forward, 0, 0, 0, 0.7))
    c.wait(2.0)
    assert c.autopilot.vehicle.velocity[0] > 0.5
    assert c.autopilot.vehicle.velocity[2] == pytest.approx(-1.0, abs=0.1)


def test_reposition_is_flown_only_where_permitted():
    c = Client()
    c.up()
    c.command(MODE, 1, 17)
    lat, lon = c.fake.place.at(5.0, 5.0)
    height = c.fake.place.altitude + 6.0
    assert c.command_int(192, -1, 0, 0, 0, x=lat, y=lon, z=height) == DENIED, (
        "not in GUIDED, and no mode change requested"
    )
    assert c.command_int(192, -1, 1, 0, 0, x=lat, y=lon, z=height) == ACCEPTED
    c.wait(6.0)
    assert math.dist(c.place, (5, 5, -6)) < 0.2
    assert c.command_int(192, 0, 1, x=0, y=0, z=0.0) == DENIED, "the goal is too far away"
    c.autopilot.parameters.update({"FENCE_ENABLE": 1, "FENCE_RADIUS": 20})
    lat, lon = c.fake.place.at(50.0, 0.0)
    assert c.command_int(192, -1, 1, x=lat, y=lon, z=height) == FAILED


def test_set_home_and_flight_termination():
    c = Client()
    c.up()
    c.target(POSITION, place=(10, 0, -5))
    c.wait(8.0)
    assert c.command(179, 1) == ACCEPTED
    assert c.autopilot.home == c.place
    assert c.command(185, 1) == ACCEPTED
    c.wait(3.0)
    assert c.place[2] == 0.0
    assert not c.autopilot.armed


def test_payload_commands_and_telemetry():
    c = Client()
    assert c.command(183, 9, 1700) == ACCEPTED
    assert c.ask(36).servo9_raw == 1700
    assert c.command(183, 99, 1700) == FAILED
    assert c.command(181, 2, 1) == ACCEPTED
    assert c.ask(376).on == 0b100
    assert c.command(211, 1, 1) == ACCEPTED
    assert c.autopilot.payload.gripped
    assert c.command(42600, 1, 1, 3.0, 1.0) == ACCEPTED
    c.wait(1.0)
    assert c.ask(9005).line_length == pytest.approx(1.0, abs=0.05)
    c.wait(3.0)
    assert c.ask(9005).line_length == pytest.approx(3.0)
    assert c.command(1000, -45, 30, NAN, NAN) == ACCEPTED
    c.wait(1.0)
    status = c.ask(158)
    assert (status.pointing_a, status.pointing_c) == (-4500, 3000)
    assert c.command(203, 0, 0, 0, 0, 1) == ACCEPTED
    assert c.messages[-1].get_type() == "CAMERA_FEEDBACK"
    c.wait(0.5)
    assert c.command(2000, 0, 0, 1) == ACCEPTED
    assert c.messages[-1].img_idx == 2
    assert c.command(34) == UNSUPPORTED, "ArduCopter has no orbit"


def test_ping_timesync_and_system_time_are_answered():
    c = Client()
    (pong,) = c.send(dialect.MAVLink_ping_message(1, 7, 0, 0))
    assert (pong.seq, pong.target_system) == (7, 255)
    (answer,) = c.send(dialect.MAVLink_timesync_message(0, 1234))
    assert answer.ts1 == 1234
    assert c.ask(2).time_unix_usec > 1.7e15


@pytest.mark.parametrize(("action", "mode"), [(5, "LAND"), (7, "BRAKE")])
def test_gcs_failsafe_action_by_parameter(action, mode):
    c = Client()
    c.up()
    c.autopilot.parameters.update({"FS_GCS_ENABLE": action, "FS_GCS_TIMEOUT": 2})
    c.heartbeat()
    c.wait(2.2)
    assert c.autopilot.mode == mode
    assert c.autopilot.critical


def test_gcs_failsafe_continues_a_landing_by_option():
    c = Client()
    c.up(20.0)
    c.autopilot.parameters.update({"FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": 2, "FS_OPTIONS": 8})
    c.heartbeat()
    c.command(21)
    c.wait(3.0)
    assert "GCS Failsafe - Continuing Landing" in c.texts()
    assert c.autopilot.mode == "LAND"


def test_rover_holds_when_the_station_is_lost():
    c = Client("rover")
    c.autopilot.parameters.update({"FS_GCS_ENABLE": 1, "FS_GCS_TIMEOUT": 2})
    c.command(MODE, 1, 15)
    c.command(ARM, 1)
    c.heartbeat()
    c.wait(3.4)
    assert c.autopilot.mode == "GUIDED", "FS_TIMEOUT is added to FS_GCS_TIMEOUT"
    c.wait(0.3)
    assert c.autopilot.mode == "HOLD"
    assert "Radio Failsafe" in c.texts()


def test_low_battery_leads_to_a_return():
    c = Client()
    c.autopilot.parameters["BATT_FS_LOW_ACT"] = 2
    c.up()
    c.fault("battery=0.15")
    c.wait(0.2)
    assert c.autopilot.mode == "RTL"
    assert c.ask(147).battery_remaining == 15


def test_gps_loss_lands_by_the_ekf_failsafe_and_blocks_arming():
    c = Client()
    c.up()
    c.command(STREAM, 33, 100_000)
    c.fault("gps_loss=true")
    c.messages.clear()
    c.wait(8.0)
    # As recorded (gauntlet-a): the flight and the position reports continue.
    assert [m for m in c.messages if m.get_type() == "GLOBAL_POSITION_INT"]
    assert c.ask(24).fix_type == dialect.GPS_FIX_TYPE_NO_FIX
    assert not c.ask(1).onboard_control_sensors_health & 0x20
    assert c.autopilot.mode == "GUIDED"
    c.wait(0.3)
    assert c.autopilot.mode == "LAND"
    assert c.command(MODE, 1, GUIDED) == FAILED
    c.wait(0.1)
    assert {"EKF variance", "Mode change to GUIDED failed: requires position"} <= set(c.texts())
    before = c.place[2]
    c.wait(2.5)
    assert c.place[2] == before, "a landing by a failsafe hovers first"
    c.wait(17.0)
    assert c.command(MODE, 1, GUIDED) == ACCEPTED
    assert c.command(ARM, 1) == FAILED
    assert "Arm: Need Position Estimate" in [
        *c.texts(),
        *(m.text for m in c.wait(0.1) if m.get_msgId() == 253),
    ]
    c.fault("gps_loss=false")
    assert c.command(ARM, 1) == ACCEPTED


def test_motor_failure_crashes_the_copter():
    c = Client()
    c.up(10.0)
    c.fault("motor_failure=true")
    c.wait(3.0)
    assert c.place[2] == 0.0
    assert not c.autopilot.armed
    assert {"Potential Thrust Loss (1)", "Crash: Disarming"} <= set(c.texts())
    assert c.command(ARM, 1) == ACCEPTED
    assert c.command(22, 0, 0, 0, 0, 0, 0, 5) == ACCEPTED
    c.wait(4.0)
    assert c.place[2] > -0.5, "it cannot stay in the air"


def test_arming_is_refused_while_the_fault_is_set():
    c = Client(faults=["refuse_arming=no compass"])
    assert c.command(ARM, 1) == FAILED
    c.wait(0.1)
    assert c.texts() == ["Arm: no compass"]
    c.fault("refuse_arming=")
    assert c.command(ARM, 1) == ACCEPTED


def test_delay_and_duplicate_faults():
    c = Client(faults=["delay=0.5", "duplicate=1"])
    assert c.command(MODE, 1, GUIDED) is None
    c.messages.clear()
    c.wait(0.4)
    assert not [m for m in c.messages if m.get_type() == "COMMAND_ACK"]
    c.wait(0.2)
    assert len([m for m in c.messages if m.get_type() == "COMMAND_ACK"]) == 2


def test_reorder_fault_delivers_all_packets():
    c = Client(faults=["reorder=0.3"])
    c.command(STREAM, 32, 20_000)
    received = [m.get_seq() for m in c.wait(4.0)]
    assert received != sorted(received)
    assert len(set(received)) > 150


def test_corrupt_fault_breaks_the_set_share_of_packets():
    fake = MavlinkFake(Autopilot(FLAVOURS["px4"]["copter"]), faults=make_faults("corrupt=0.5"))
    packets = [p for _ in range(100) for p in fake.advance(0.02)]
    reader = dialect.MAVLink(None)
    reader.robust_parsing = True
    good = [m for p in packets for m in reader.parse_buffer(p) or [] if m.get_type() != "BAD_DATA"]
    assert 0.3 * len(packets) < len(good) < 0.7 * len(packets)


def pair() -> MavlinkLink:
    faults = make_faults(systems=(1, 2))
    kinds = [FLAVOURS["ardupilot"]["rover"], FLAVOURS["px4"]["copter"]]
    return MavlinkLink(
        [MavlinkFake(Autopilot(kind), system=n, faults=faults) for n, kind in enumerate(kinds, start=1)]
    )


def parse(packets) -> list:
    return dialect.MAVLink(None).parse_buffer(b"".join(packets)) or []


def test_vehicles_of_one_link_are_addressed_by_system_id():
    link = pair()
    received = parse(p for _ in range(60) for p in link.advance(0.02))
    assert {(m.get_srcSystem(), m.autopilot) for m in received if m.get_type() == "HEARTBEAT"} == {
        (1, 3),
        (2, 12),
    }
    client = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
    arm = dialect.MAVLink_command_long_message(2, 1, ARM, 0, 1, 0, 0, 0, 0, 0, 0)
    (ack,) = parse(link.receive("c", arm.pack(client)))
    assert (ack.get_srcSystem(), ack.result) == (2, ACCEPTED)
    assert [v.autopilot.armed for v in link.vehicles] == [False, True]


def test_fault_of_one_vehicle_does_not_affect_the_other():
    link = pair()
    link.vehicles[0].faults.apply(["silence@2=true"])
    assert {m.get_srcSystem() for m in parse(link.advance(1.0))} == {1}


def home_positions(c):
    return [(m.x, m.z) for m in c.messages if m.get_type() == "HOME_POSITION"]


def test_ardupilot_sends_home_when_it_is_set():
    c = Client()
    c.wait(1.0)
    assert not home_positions(c), "it was set before"
    c.autopilot.vehicle.place = (15.0, 0.0, 0.0)
    assert c.command(MODE, 1, GUIDED) == ACCEPTED
    assert c.command(ARM, 1) == ACCEPTED
    c.wait(0.02)
    assert home_positions(c) == [(15.0, 0.0)]
    c.wait(2.0)
    assert len(home_positions(c)) == 1
    cold = Client(faults=["warm_up=10"])
    cold.wait(4.6)
    assert not home_positions(cold)
    cold.wait(0.2)
    assert {m.get_type() for m in cold.messages} >= {"HOME_POSITION", "GPS_GLOBAL_ORIGIN"}


def test_rover_uses_the_height_of_a_set_home():
    c = Client("rover")
    own = c.ask(HOME_POSITION)
    assert own.altitude == 190
    assert c.command(SET_HOME, 1) == ACCEPTED
    assert c.ask(HOME_POSITION).altitude == round(c.fake.place.altitude * 1000)
    assert c.command_int(SET_HOME, x=own.latitude + 900, y=own.longitude, z=493.0) == ACCEPTED
    assert c.ask(HOME_POSITION).altitude == 493_000


def test_px4_accepts_home_during_calibration_without_an_answer():
    c = Client(flavour="px4")
    before = c.ask(HOME_POSITION)
    assert c.command(CALIBRATE, 1) == ACCEPTED
    assert c.command_int(SET_HOME, x=before.latitude + 900, y=before.longitude, z=490.0) is None
    assert c.ask(HOME_POSITION).latitude == pytest.approx(before.latitude + 900, abs=2)


def test_start_position_faults_place_and_move_a_vehicle():
    c = Client(faults=("north=30", "east=-40"))
    assert GeoOrigin().local(c.ask(33).lat, c.ask(33).lon) == pytest.approx((30.0, -40.0), abs=0.02)
    assert (c.ask(32).x, c.ask(32).y) == (0.0, 0.0), "its local origin is the start position"
    c.fault("north=32")
    assert (c.ask(32).x, c.ask(32).y) == (2.0, 0.0), "and moved from there"
    c.up()
    assert GeoOrigin().local(c.ask(33).lat, c.ask(33).lon) == pytest.approx((32.0, -40.0), abs=0.1)


def test_rover_reports_distance_to_a_goal_and_0_for_a_velocity():
    """As in ap-rover.c-speed and ap-rover.f-fence-breach; in HOLD it reports none."""
    c = Client("rover")
    kind = dialect.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT
    assert c.command(STREAM, kind, 2e5) == ACCEPTED

    def distances():
        c.messages.clear()
        c.wait(1.0)
        return [m.wp_dist for m in c.messages if m.get_msgId() == kind]

    assert distances() == [], "it is in MANUAL or HOLD"
    assert c.command(MODE, 1, 15) == ACCEPTED
    assert c.command(ARM, 1) == ACCEPTED
    assert set(distances()) == {0}
    c.target(POSITION, place=(40.0, 0.0, 0.0))
    assert all(30 < distance <= 40 for distance in distances())
    c.target(VELOCITY, velocity=(1.0, 0.0, 0.0))
    assert set(distances()) == {0}
