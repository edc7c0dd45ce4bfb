"""The fake used by third-party software in virtual time: pymavlink's mavutil, mavwp and mavftp, and dronekit.

dronekit itself does not run on Python 3.11; its messages on the wire are reproduced here:
it reads home from item 0 of a mission, flies to a `MISSION_ITEM` with current = 2, and arms through mavutil.
MAVSDK has its own tests (`tests/mavlink/client`).
"""

from __future__ import annotations

import math

import pytest
from pymavlink import mavftp, mavutil, mavwp

from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.mavlink_fake import STEP, MavlinkFake

dialect = mavutil.mavlink
HOME = (-35.3632621, 149.1652374, 584.0)
BOTH = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


class Connection(mavutil.mavfile):
    """mavutil's connection to a fake; time advances during a wait.

    It returns the requested number of bytes, so that no time passes while messages are unread: a client
    that reads one message per step falls behind PX4's stream and receives answers seconds late.
    """

    def __init__(self, flavour="ardupilot"):
        self.autopilot = Autopilot(FLAVOURS[flavour]["copter"])
        self.fake = MavlinkFake(self.autopilot, place=GeoOrigin(*HOME))
        self._waiting = bytearray()
        self._reader = dialect.MAVLink(None)
        self._reader.robust_parsing = True
        self.read_texts = []
        super().__init__(None, "fake", source_system=255, source_component=190)
        self.heartbeat()
        self.wait_heartbeat(timeout=5)

    def recv(self, n=None):
        if not self._waiting:
            self.pass_time(STEP)
        data = bytes(self._waiting[:n])
        del self._waiting[:n]
        return data

    def post_message(self, msg):
        if msg.get_type() == "STATUSTEXT":
            self.read_texts.append(msg.text)
        super().post_message(msg)

    def write(self, buf):
        for packet in self.fake.receive("client", bytes(buf)):
            self._waiting += packet

    def select(self, timeout):
        return True

    def heartbeat(self):
        self.mav.heartbeat_send(6, 8, 0, 0, 4)

    def pass_time(self, seconds):
        for _ in range(round(seconds / STEP)):
            if int(self.autopilot.now) != int(self.autopilot.now - STEP):
                self.heartbeat()
            for packet in self.fake.advance(STEP):
                self._waiting += packet

    def texts(self, seconds):
        """The status texts of the next seconds and all earlier ones."""
        self.pass_time(seconds)
        packets, self._waiting = bytes(self._waiting), bytearray()
        messages = self._reader.parse_buffer(packets) or []
        return [*self.read_texts, *(m.text for m in messages if m.get_type() == "STATUSTEXT")]

    def ack(self, command):
        """The final result of a command, as its name."""
        while True:
            message = self.recv_match(type="COMMAND_ACK", blocking=True, timeout=5)
            assert message is not None
            if message.command == command and message.result != dialect.MAV_RESULT_IN_PROGRESS:
                return dialect.enums["MAV_RESULT"][message.result].name.removeprefix("MAV_RESULT_")


def download(c):
    """A mission as dronekit and older stations read it: by MISSION_REQUEST, into mavwp's loader."""
    loader = mavwp.MAVWPLoader()
    c.waypoint_request_list_send()
    count = c.recv_match(type="MISSION_COUNT", blocking=True, timeout=5)
    assert count is not None
    for number in range(count.count):
        c.waypoint_request_send(number)
        item = c.recv_match(type=["MISSION_ITEM", "MISSION_ITEM_INT"], blocking=True, timeout=5)
        assert item is not None
        loader.add(item)
    c.mav.mission_ack_send(1, 1, 0)
    return loader


def upload(c, loader):
    """A mission by mavwp's loader; the result."""
    c.waypoint_count_send(loader.count())
    while True:
        request = c.recv_match(
            type=["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], blocking=True, timeout=5
        )
        if request.get_type() == "MISSION_ACK":
            return request.type
        c.mav.send(loader.wp(request.seq))


def waypoint(number, latitude, longitude, height, *, current=0, command=16):
    return dialect.MAVLink_mission_item_message(
        1, 1, number, 3, command, current, 1, 0, 0, 0, 0, latitude, longitude, height
    )


def up(c, height=10.0):
    c.set_mode_apm("GUIDED")
    c.arducopter_arm()
    assert c.ack(400) == "ACCEPTED"
    c.mav.command_long_send(1, 1, 22, 0, 0, 0, 0, 0, 0, 0, height)
    assert c.ack(22) == "ACCEPTED"
    c.pass_time(20.0)
    while c.recv_match(type="HEARTBEAT", blocking=False):
        pass


def test_dronekit_finds_home_in_the_mission_of_a_new_vehicle():
    loader = download(Connection())
    assert loader.count() == 1
    home = loader.wp(0)
    assert (home.x, home.y, home.z) == pytest.approx(HOME, abs=1e-4)


def test_dronekit_flies_to_a_guided_item():
    c = Connection()
    up(c)
    place = c.fake.place.at(20.0, 0.0)
    c.mav.mission_item_send(0, 0, 0, 3, 16, 2, 0, 0, 0, 0, 0, place[0] / 1e7, place[1] / 1e7, 10.0)
    assert c.recv_match(type="MISSION_ACK", blocking=True, timeout=5).type == 0
    c.pass_time(15.0)
    assert c.autopilot.vehicle.place == pytest.approx((20.0, 0.0, -10.0), abs=2.0)


@BOTH
def test_mavwp_uploads_and_downloads_a_mission(flavour):
    c = Connection(flavour)
    loader = mavwp.MAVWPLoader()
    places = [(HOME[0] + n * 1e-4, HOME[1], 8.0 + n) for n in range(4)]
    for number, place in enumerate(places):
        loader.add(waypoint(number, *place))
    assert upload(c, loader) == 0
    read = download(c)
    assert [round(read.wp(n).z) for n in range(1, 4)] == [9, 10, 11]


def test_px4_disarmed_in_takeoff_mode_does_not_take_off_later():
    c = Connection("px4")
    c.pass_time(1.0)
    for number, values in [(400, (1,)), (176, (1, 4, 2)), (400, (0,)), (400, (1,))]:
        c.mav.command_long_send(1, 1, number, 0, *values, *[0] * (7 - len(values)))
        assert c.ack(number) == "ACCEPTED"
    c.pass_time(5.0)
    assert c.autopilot.mode == "AUTO.LOITER"
    assert not c.autopilot.vehicle.airborne


def test_mavutil_arms_and_changes_modes():
    c = Connection()
    assert c.mode_mapping()["GUIDED"] == 4
    up(c)
    assert c.motors_armed()
    assert c.flightmode == "GUIDED"
    c.set_mode_rtl()
    c.pass_time(2.0)
    c.recv_match(type="HEARTBEAT", blocking=True, timeout=5)
    assert c.autopilot.mode == "RTL"


@BOTH
def test_mavutil_reads_and_sets_parameters(flavour):
    c = Connection(flavour)
    name, other = ("RTL_ALT", 2000.0) if flavour == "ardupilot" else ("MIS_TAKEOFF_ALT", 7.5)
    c.param_fetch_one(name)
    first = c.recv_match(type="PARAM_VALUE", blocking=True, timeout=5)
    assert first.param_id == name
    c.param_set_send(name, other, parm_type=first.param_type)
    assert c.recv_match(type="PARAM_VALUE", blocking=True, timeout=5).param_value == other


@pytest.mark.parametrize(
    ("flavour", "values", "result", "text"),
    [
        ("ardupilot", (1,), "ACCEPTED", "Initialising ArduPilot"),
        ("ardupilot", (0, 0, 1), "ACCEPTED", "Barometer calibration complete"),
        ("ardupilot", (0, 1), "UNSUPPORTED", ""),
        ("ardupilot", (0, 0, 0, 0, 1), "ACCEPTED", "Place vehicle level and press any key."),
        ("px4", (1,), "ACCEPTED", "[cal] calibration done: gyro"),
        ("px4", (0, 0, 0, 0, 2), "ACCEPTED", "[cal] calibration done: level"),
        ("px4", (0, 1), "ACCEPTED", "[cal] Rotate vehicle"),
    ],
)
def test_calibration_is_answered_as_recorded(flavour, values, result, text):
    c = Connection(flavour)
    c.mav.command_long_send(1, 1, 241, 0, *values, *[0] * (7 - len(values)))
    assert c.ack(241) == result
    texts = c.texts(4.0)
    assert not text or text in texts


@pytest.mark.parametrize(
    ("command", "values", "ardupilot", "px4"),
    [
        (410, (), "ACCEPTED", "ACCEPTED"),
        (520, (1,), "ACCEPTED", "ACCEPTED"),
        (519, (1,), "UNSUPPORTED", "ACCEPTED"),
        (401, (), "ACCEPTED", "ACCEPTED"),
        (209, (1, 0, 5, 1, 1), "ACCEPTED", "UNSUPPORTED"),
        (512, (435,), "ACCEPTED", "ACCEPTED"),
    ],
)
@BOTH
def test_older_command_is_answered_as_recorded(flavour, command, values, ardupilot, px4):
    c = Connection(flavour)
    c.mav.command_long_send(1, 1, command, 0, *values, *[0] * (7 - len(values)))
    assert c.ack(command) == (ardupilot if flavour == "ardupilot" else px4)


def test_motor_test_while_armed_blocks_arming_until_a_reboot():
    c = Connection()
    c.set_mode_apm("GUIDED")
    c.arducopter_arm()
    assert c.ack(400) == "ACCEPTED"
    c.mav.command_long_send(1, 1, 209, 0, 1, 0, 5, 1, 1, 0, 0)
    assert c.ack(209) == "ACCEPTED"
    c.arducopter_arm()
    assert c.ack(400) == "ACCEPTED"
    c.pass_time(2.0)
    assert not c.autopilot.armed
    c.mav.command_long_send(1, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)
    assert c.ack(246) == "ACCEPTED"
    c.pass_time(6.0)
    up(c)
    assert c.autopilot.armed


@BOTH
def test_log_list_has_an_entry(flavour):
    c = Connection(flavour)
    c.mav.log_request_list_send(1, 1, 0, 0xFFFF)
    entry = c.recv_match(type="LOG_ENTRY", blocking=True, timeout=5)
    assert entry.num_logs == 1
    assert entry.size > 0


def test_px4_sends_nothing_after_shutdown():
    c = Connection("px4")
    c.mav.command_long_send(1, 1, 246, 0, 2, 0, 0, 0, 0, 0, 0)
    c._waiting.clear()
    c.pass_time(5.0)
    assert not c._waiting


@BOTH
def test_mavftp_lists_a_folder(flavour):
    c = Connection(flavour)
    ftp = mavftp.MAVFTP(c, 1, 1)
    result = ftp.cmd_list(["/"])
    assert result.error_code == mavftp.FtpError.Success
    assert "APM" in [e.name for e in ftp.list_result] or "etc" in [e.name for e in ftp.list_result]


def test_px4_follows_acceleration_setpoints():
    c = Connection("px4")
    c.pass_time(1.0)
    c.arducopter_arm()
    assert c.ack(400) == "ACCEPTED"
    c.mav.command_long_send(1, 1, 22, 0, 0, 0, 0, math.nan, math.nan, math.nan, math.nan)
    assert c.ack(22) == "ACCEPTED"
    c.pass_time(15.0)
    for number in range(60):
        c.mav.set_position_target_local_ned_send(0, 1, 1, 1, 0x0C3F, *[0] * 6, 0.5, 0, 0, 0, 0)
        if number == 10:
            c.mav.command_long_send(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
        c.pass_time(0.05)
    assert c.autopilot.mode == "OFFBOARD"
    assert c.autopilot.vehicle.velocity[0] > 0.5
