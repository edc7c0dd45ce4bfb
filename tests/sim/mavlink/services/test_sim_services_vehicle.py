"""The services on a moving vehicle: missions, fences, typed parameters, files."""

from __future__ import annotations

import argparse
import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from lfield_sim.autopilot.autopilot import FLAVOURS, Autopilot
from lfield_sim.autopilot.flavours import MavResult, Role
from lfield_sim.mavlink import SIM
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.link_setup import LinkSetup
from lfield_sim.mavlink.mav_command import MavCommand
from lfield_sim.mavlink.services.file_service import FileService, packed_parameters
from lfield_sim.mavlink.services.ftp import FtpOpcode, FtpPacket
from lfield_sim.mavlink.services.parameters import ParameterService, ParameterType, parameter_table
from lfield_sim.mavlink.services.plan_items import PlanItem, PlanResult, PlanType
from lfield_sim.mavlink.services.plan_service import PlanService

STEP = 0.02
TAKEOFF, WAYPOINT, LAND, RETURN, SPEED, JUMP = 22, 16, 21, 20, 178, 177
BOTH = pytest.mark.parametrize("flavour", ["ardupilot", "px4"])


class Craft:
    """A vehicle with one service, and a ground station that sends messages."""

    def __init__(self, service, flavour="ardupilot", kind="copter"):
        self.pilot, self.place = Autopilot(FLAVOURS[flavour][kind]), GeoOrigin()
        self.service = service(self.pilot, self.place)
        self.pilot.station_at = math.inf
        self.received = []

    def send(self, message):
        (received,) = dialect.MAVLink(None).parse_buffer(message.pack(dialect.MAVLink(None, 255, 190)))
        return self.service.handles[received.get_msgId()](received)

    def command(self, number, *values):
        result, replies = self.service.commands[number](
            MavCommand(number, (*values, *[0.0] * (7 - len(values))))
        )
        self.received += replies
        return result

    def wait(self, seconds):
        received = []
        for _ in range(round(seconds / STEP)):
            self.pilot.step(STEP)
            received += self.service.advance(self.pilot.now)
        self.received += received
        return received

    def upload(self, items, kind=PlanType.MISSION):
        """Uploads a plan; for ArduPilot with item 0 before a mission."""
        if kind is PlanType.MISSION and self.pilot.flavour.home_item:
            items = [self.item(WAYPOINT, 0, 0, 0), *items]
        answers = self.send(dialect.MAVLink_mission_count_message(1, 1, len(items), int(kind)))
        for number, item in enumerate(items):
            assert answers[0].seq == number
            answers = self.send(item.write((1, 1), number, kind, current=False))
        assert answers[0].type == PlanResult.ACCEPTED
        return answers

    def item(self, command, north=0.0, east=0.0, height=5.0, values=(0, 0, 0, 0)):
        return PlanItem(command, 6, values, *self.place.at(north, east), height)

    def arm(self):
        mode = self.pilot.kind.modes[self.pilot.kind.mode_for(Role.GUIDED)]
        if self.pilot.flavour.name == "ardupilot":
            assert self.pilot.set_mode(mode.number) is MavResult.ACCEPTED
        assert self.pilot.arm() is MavResult.ACCEPTED

    def reached(self):
        """Each item once: PX4 repeats the report."""
        return list(dict.fromkeys(m.seq for m in self.received if m.get_type() == "MISSION_ITEM_REACHED"))

    def current(self):
        return self.service.messages[dialect.MAVLINK_MSG_ID_MISSION_CURRENT]()


@BOTH
def test_mission_is_flown_item_by_item_and_returns(flavour):
    c = Craft(PlanService, flavour)
    first = 1 if flavour == "ardupilot" else 0
    assert c.current().mission_state == dialect.MISSION_STATE_NO_MISSION
    c.upload([c.item(TAKEOFF), c.item(WAYPOINT, 20.0), c.item(WAYPOINT, 20.0, 10.0), c.item(RETURN)])
    assert c.current().mission_state == dialect.MISSION_STATE_NOT_STARTED
    c.arm()
    assert c.command(300) is MavResult.ACCEPTED
    assert c.pilot.role is Role.MISSION
    c.wait(7.0)
    assert c.current().mission_state == dialect.MISSION_STATE_ACTIVE
    c.wait(83.0)
    assert c.reached()[:3] == [first, first + 1, first + 2]
    changes = [m for m in c.received if m.get_type() == "MISSION_CURRENT"]
    assert [m.seq for m in changes] == sorted(m.seq for m in changes)
    assert dialect.MISSION_STATE_ACTIVE in {m.mission_state for m in changes}
    assert (c.pilot.armed, c.pilot.vehicle.airborne) == (False, False)
    assert math.dist(c.pilot.vehicle.place, (0, 0, 0)) < 1.0


@BOTH
def test_mission_that_lands_is_complete(flavour):
    c = Craft(PlanService, flavour)
    c.upload([c.item(TAKEOFF), c.item(LAND, 8.0, 0.0, 0.0)])
    c.arm()
    c.command(300)
    c.wait(40.0)
    assert not c.pilot.armed
    assert c.pilot.vehicle.place == pytest.approx((8.0, 0.0, 0.0), abs=1.0)
    last = [m for m in c.received if m.get_type() == "MISSION_CURRENT"][-1]
    assert last.mission_state == c.current().mission_state == dialect.MISSION_STATE_COMPLETE


@BOTH
def test_mission_is_paused_resumed_and_jumped(flavour):
    c = Craft(PlanService, flavour)
    ardupilot = flavour == "ardupilot"
    first = 1 if ardupilot else 0
    c.upload([c.item(TAKEOFF), c.item(WAYPOINT, 100.0), c.item(WAYPOINT, 0.0, 50.0)])
    assert c.command(193, 0) is (MavResult.DENIED if ardupilot else MavResult.UNSUPPORTED), (
        "no mission is active"
    )
    c.arm()
    c.command(300)
    c.wait(10.0)
    # PX4 is stopped by a change of mode.
    hold = c.pilot.kind.modes[c.pilot.kind.mode_for(Role.HOLD)].number
    assert (c.command(193, 0) if ardupilot else c.pilot.set_mode(hold)) is MavResult.ACCEPTED
    c.wait(6.0)
    here = c.pilot.vehicle.place
    assert c.current().mission_state == dialect.MISSION_STATE_PAUSED
    c.wait(3.0)
    assert c.pilot.vehicle.place == pytest.approx(here, abs=0.01)
    assert c.command(193 if ardupilot else 300, int(ardupilot)) is MavResult.ACCEPTED
    assert c.current().seq == first + 1
    if ardupilot:
        assert c.command(224, first + 2) is MavResult.ACCEPTED
        assert c.command(224, 99) is MavResult.DENIED
    else:
        assert c.command(224, first + 2) is MavResult.UNSUPPORTED
        c.send(dialect.MAVLink_mission_set_current_message(1, 1, first + 2))
    c.wait(2.0)
    assert c.current().seq == first + 2
    replies = c.send(dialect.MAVLink_mission_set_current_message(1, 1, first))
    assert [m.seq for m in replies] == ([first] if ardupilot else []), "PX4 reports it with its stream"
    assert c.current().seq == first
    assert c.send(dialect.MAVLink_mission_set_current_message(1, 1, 77)) == []
    assert c.command(193, 7) is (MavResult.DENIED if ardupilot else MavResult.UNSUPPORTED)


@BOTH
def test_start_without_a_mission_fails(flavour):
    c = Craft(PlanService, flavour)
    c.arm()
    before = c.pilot.mode
    assert c.command(300) is (MavResult.FAILED if flavour == "ardupilot" else MavResult.ACCEPTED)
    assert c.pilot.mode == before
    assert c.pilot.pop_texts()[-1] in (
        "Mode change to AUTO failed: init failed",
        "Switching to Mission is currently not available\t",
    )


def test_ardupilot_has_home_as_item_0_and_counts_in_a_parameter():
    c = Craft(PlanService)
    c.upload([c.item(TAKEOFF), c.item(WAYPOINT, 5.0)])
    assert c.pilot.parameters["MIS_TOTAL"] == 3.0
    (item,) = c.send(dialect.MAVLink_mission_request_int_message(1, 1, 0, 0))
    assert (item.x, item.y, item.frame) == (*c.place.at(0.0, 0.0), 0)
    assert item.z == pytest.approx(488.0)


@pytest.mark.parametrize(("frame", "z"), [(6, 12.0), (3, 12.0), (5, 500.0), (0, 500.0), (11, 12.0)])
def test_item_height_is_converted_in_every_frame(frame, z):
    c = Craft(PlanService, "px4")
    c.upload([PlanItem(WAYPOINT, frame, (0, 0, 0, 0), *c.place.at(3.0, 4.0), z)])
    assert c.pilot.mission.items[0].place == pytest.approx((3.0, 4.0, -12.0), abs=0.02)


def test_zero_coordinates_mean_here_and_takeoff_keeps_its_height():
    c = Craft(PlanService, "px4")
    items = [PlanItem(WAYPOINT, 6, (0, 0, 0, 0), 0, 0, 9.0), PlanItem(TAKEOFF, 6, (0, 0, 0, 0), 0, 0, 9.0)]
    c.upload([*items, PlanItem(SPEED, 2, (1, 3.0, -1, 0))])
    here, up, speed = c.pilot.mission.items
    assert (here.place, speed.place) == (None, None)
    assert up.place[2] == -9.0


@BOTH
def test_uploaded_fence_is_enforced(flavour):
    c = Craft(PlanService, flavour)
    corners = [
        c.item(5001, n, e, values=(4, 0, 0, 0)) for n, e in ((-20, -20), (-20, 20), (20, 20), (20, -20))
    ]
    c.upload(corners, PlanType.FENCE)
    if flavour == "ardupilot":
        assert c.pilot.parameters["FENCE_TOTAL"] == 4.0
        c.pilot.parameters["FENCE_ENABLE"] = 1.0
    c.upload([c.item(TAKEOFF), c.item(WAYPOINT, 60.0)])
    c.arm()
    c.command(300)
    c.wait(25.0)
    assert c.pilot.role is (Role.RETURN if flavour == "ardupilot" else Role.HOLD)
    assert c.pilot.failsafes.fences.breaches >= 1
    c.send(dialect.MAVLink_mission_clear_all_message(1, 1, 1))
    assert c.pilot.fence.breached((1e4, 0.0, 0.0)) == 0


def test_enabled_fence_requires_a_position_to_arm():
    c = Craft(PlanService)
    assert c.command(207, 1) is MavResult.ACCEPTED
    assert c.pilot.parameters["FENCE_ENABLE"] == 1.0
    c.pilot.gps_lost = True
    assert c.pilot.arm() is MavResult.FAILED
    assert c.pilot.pop_texts()[-1] == "Arm: Fence enabled, need position estimate"
    assert c.command(207, 0) is MavResult.ACCEPTED
    assert c.pilot.arm() is MavResult.FAILED
    assert c.pilot.pop_texts()[-1] == "Arm: Need Position Estimate"
    assert c.command(207, 7) is MavResult.FAILED
    assert Craft(PlanService, "px4").command(207, 1) is MavResult.UNSUPPORTED


def test_reboot_aborts_an_upload_and_keeps_the_plan():
    c = Craft(PlanService)
    c.upload([c.item(TAKEOFF)])
    c.send(dialect.MAVLink_mission_count_message(1, 1, 5, 0))
    c.service.reboot()
    assert {m.get_type() for m in c.wait(10.0)} == {"MISSION_CURRENT"}
    assert len(c.pilot.mission.items) == 2


# -- parameters ---------------------------------------------------------------------------------------------


def read(c, name):
    """Reads a parameter by name; ArduPilot's answer is delayed."""
    answers = c.send(dialect.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    answers = answers or [m for m in c.wait(0.2) if m.param_id == name]
    return answers[0] if answers else None


def set_(c, name, value, kind):
    answers = c.send(dialect.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    return answers[0] if answers else None


def as_float(value):
    return struct.unpack("<f", struct.pack("<i", value))[0]


@pytest.mark.parametrize("kind", ["copter", "rover"])
@BOTH
def test_parameter_list_is_complete_numbered_and_paced(flavour, kind):
    c = Craft(ParameterService, flavour, kind)
    first = c.send(dialect.MAVLink_param_request_list_message(1, 1))
    hashed = [] if flavour == "ardupilot" else [("_HASH_CHECK", 65535, dialect.MAV_PARAM_TYPE_UINT32)]
    assert [(m.param_id, m.param_index, m.param_type) for m in first] == hashed
    c.received.clear()
    assert len(c.wait(STEP)) == 30
    c.wait(2.0)
    assert [m.param_index for m in c.received] == list(range(len(c.received)))
    assert {m.param_count for m in c.received} == {len(c.received)}
    assert len(c.received) >= 400
    names = [m.param_id for m in c.received]
    assert names == sorted(set(names))
    assert set(c.pilot.kind.parameters) <= set(names)


def test_ardupilot_encodes_integers_as_floats():
    c = Craft(ParameterService)
    answer = read(c, "FS_GCS_ENABLE")
    assert (answer.param_value, answer.param_type) == (0.0, ParameterType.INT8)
    assert set_(c, "FS_GCS_ENABLE", 1.9, ParameterType.REAL32).param_value == 1.0
    assert set_(c, "FS_GCS_ENABLE", 500.0, ParameterType.INT32).param_value == 127.0
    assert set_(c, "WPNAV_SPEED", 123.5, ParameterType.REAL32).param_value == 123.5
    assert c.pilot.own_speed() == pytest.approx(1.235)


def test_px4_encodes_integers_bytewise_and_checks_types():
    c = Craft(ParameterService, "px4")
    answer = read(c, "SYS_AUTOSTART")
    assert (answer.param_value, answer.param_type) == (as_float(10040), ParameterType.INT32)
    assert set_(c, "NAV_DLL_ACT", as_float(2), ParameterType.INT32).param_value == as_float(2)
    assert c.pilot.parameters["NAV_DLL_ACT"] == 2.0
    assert set_(c, "NAV_DLL_ACT", 3.0, ParameterType.REAL32) is None
    assert c.pilot.pop_texts() == []
    assert set_(c, "NAV_DLL_ACT", as_float(-1), ParameterType.INT32) is not None
    assert c.pilot.parameters["NAV_DLL_ACT"] == -1.0


@BOTH
def test_unknown_parameter_gets_no_answer(flavour):
    c = Craft(ParameterService, flavour)
    assert read(c, "NO_SUCH") is None
    assert set_(c, "NO_SUCH", 1.0, ParameterType.REAL32) is None
    count = len(c.pilot.parameters)
    assert c.send(dialect.MAVLink_param_request_read_message(1, 1, b"", count)) == []
    assert (
        c.send(dialect.MAVLink_param_request_read_message(1, 1, b"", count - 1))[0].param_index == count - 1
    )


def test_nan_parameter_is_accepted_only_by_px4():
    for name in ("WPNAV_SPEED", "FS_GCS_ENABLE"):
        c = Craft(ParameterService)
        before = c.pilot.parameters[name]
        for value in (math.nan, math.inf, -math.inf):
            assert set_(c, name, value, ParameterType.REAL32) is None
        assert c.pilot.parameters[name] == before
    c = Craft(ParameterService, "px4")
    assert math.isnan(set_(c, "MPC_XY_CRUISE", math.nan, ParameterType.REAL32).param_value)
    assert math.isnan(c.pilot.parameters["MPC_XY_CRUISE"])


def test_ardupilot_answers_by_name_without_index_and_delayed():
    c = Craft(ParameterService)
    request = dialect.MAVLink_param_request_read_message(1, 1, b"FS_GCS_ENABLE", -1)
    assert c.send(request) == []
    assert c.wait(0.08) == []
    (answer,) = c.wait(0.06)
    assert (answer.param_id, answer.param_index) == ("FS_GCS_ENABLE", 65535)
    assert set_(c, "FS_GCS_ENABLE", 1, ParameterType.INT8).param_index == 65535
    (answer,) = c.send(dialect.MAVLink_param_request_read_message(1, 1, b"", 3))
    assert answer.param_index == 3


def test_px4_reports_a_changed_parameter_twice():
    c = Craft(ParameterService, "px4")
    message = dialect.MAVLink_param_set_message(1, 1, b"MIS_TAKEOFF_ALT", 7.5, ParameterType.REAL32)
    assert [m.param_value for m in c.send(message)] == [7.5, 7.5]
    assert [m.param_value for m in c.send(message)] == [7.5]


@settings(max_examples=200, deadline=None)
@given(
    st.sampled_from(["ardupilot", "px4"]), st.data(), st.integers(0, 255), st.binary(min_size=4, max_size=4)
)
def test_answer_to_any_parameter_value_is_the_stored_value(flavour, data, kind, raw):
    c = Craft(ParameterService, flavour)
    name = data.draw(st.sampled_from(sorted(c.pilot.parameters)))
    answer = set_(c, name, struct.unpack("<f", raw)[0], kind)
    if answer is not None:
        again = read(c, name)
        assert struct.pack("<f", again.param_value) == struct.pack("<f", answer.param_value)
    c.wait(0.1)


# -- files --------------------------------------------------------------------------------------------------


def unpacked(data):
    """A param.pck read by its description in https://ardupilot.org/dev/docs/common-mavftp.html."""
    magic, count, total = struct.unpack_from("<HHH", data)
    assert (magic, count) == (0x671B, total)
    place, name, rows = 6, "", {}
    while place < len(data):
        kind, lengths = data[place], data[place + 1]
        common, rest = lengths & 15, (lengths >> 4) + 1
        name = name[:common] + data[place + 2 : place + 2 + rest].decode()
        form = {1: "<b", 2: "<h", 3: "<i", 4: "<f"}[kind]
        (rows[name],) = struct.unpack_from(form, data, place + 2 + rest)
        place += 2 + rest + struct.calcsize(form)
    assert len(rows) == count
    return rows


def test_packed_parameters_equal_the_listed_parameters():
    c = Craft(FileService)
    table = parameter_table("ardupilot", "copter")
    for name, row in table.items():
        c.pilot.parameters.setdefault(name, row.value)
    rows = unpacked(packed_parameters({n: (table[n].type, v) for n, v in c.pilot.parameters.items()}))
    assert rows == pytest.approx(c.pilot.parameters)


def fetch(c, path):
    ask = lambda number, opcode, **f: c.send(  # noqa: E731 - a request in one line
        dialect.MAVLink_file_transfer_protocol_message(
            0,
            1,
            1,
            FtpPacket(
                number, f.get("session", 0), opcode, len(f.get("data", b"")), data=f.get("data", b"")
            ).write(),
        )
    )
    (opened,) = ask(1, FtpOpcode.OPEN_READ, data=path.encode())
    session = FtpPacket.read(bytes(opened.payload)).session
    assert ask(3, FtpOpcode.BURST_READ, session=session) == []
    packets = [FtpPacket.read(bytes(m.payload)) for m in c.wait(3.0)]
    return b"".join(p.data for p in packets if p.opcode == 128)


def test_log_and_parameter_files_are_fetched():
    for flavour, path in (
        ("ardupilot", "/APM/LOGS/00000001.BIN"),
        ("px4", "/fs/microsd/log/2026-11-20/10_00_00.ulg"),
    ):
        assert len(fetch(Craft(FileService, flavour), path)) >= 10_000
    assert len(unpacked(fetch(Craft(FileService), "@PARAM/param.pck"))) >= 15


@pytest.mark.parametrize(
    ("words", "flavour", "result"),
    [
        (["--fitted", "none"], "ardupilot", MavResult.FAILED),
        (["--fitted", "none"], "px4", None),
        (["--fitted", "camera,gripper"], "ardupilot", MavResult.FAILED),
        (["--fitted", "gimbal"], "ardupilot", MavResult.ACCEPTED),
        ([], "px4", MavResult.ACCEPTED),
    ],
)
def test_missing_payload_answers_as_on_a_real_vehicle(words, flavour, result):
    parser = argparse.ArgumentParser()
    SIM.add_arguments(parser)
    args = parser.parse_args([*words, "--vehicle", f"1:copter:{flavour}"])
    setup = LinkSetup(args.vehicle, args.battery, None, {}, {}, args.fitted)
    (fake,) = setup.link(setup.faults([])).vehicles
    gimbal = dialect.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW
    service = next(each for each in fake.services if gimbal in each.commands)
    assert service.commands[gimbal](MavCommand(gimbal, (10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)))[0] == result


def test_unknown_payload_option_is_refused(capsys):
    parser = argparse.ArgumentParser()
    SIM.add_arguments(parser)
    with pytest.raises(SystemExit):
        parser.parse_args(["--fitted", "gripper,laser"])
    assert (
        "all, none, or some of camera, gimbal, gripper, winch, mavlink_camera, mavlink_gimbal, by commas"
        in capsys.readouterr().err
    )
