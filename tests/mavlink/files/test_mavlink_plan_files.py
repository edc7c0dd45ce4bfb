"""`.plan` and `QGC WPL` files: accepted forms, and refusals with the item's number."""

from __future__ import annotations

import json
import math

import pytest
from plan_texts import (
    HOME,
    LAND,
    TAKEOFF,
    VTOL,
    WAYPOINT,
    at,
    circle,
    landing,
    plan,
    rows,
    simple,
    survey,
    zone,
)

from lfield.driver import MissionFileError
from lfield_mavlink.files.plan_report import read_plan_file
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_check import HERE


def read(data):
    return read_plan_file("f.plan", data)


def commands(file):
    return [(each.number, each.item.command, each.part_of) for each in file.items]


def shape(fence):
    return [(zone.inclusion, len(zone.corners), zone.radius) for zone in fence]


def refusal(data):
    with pytest.raises(MissionFileError) as error:
        read(data)
    assert error.value.file == "f.plan"
    return error.value


# -- .plan ----------------------------------------------------------------------------------------------


def test_plan_with_mission_fence_and_rally_points_is_read():
    fences = {"polygons": [zone((0, 0), (0, 90), (90, 90))], "circles": [circle(200.0, inclusion=False)]}
    file = read(plan(simple(TAKEOFF), simple(WAYPOINT, 30, 40, 20.0), rally=[(5, 6, 7.0)], **fences))
    assert (file.kind, file.firmware, file.hover_speed, file.cruise_speed) == (
        "copter",
        "ardupilot",
        5.0,
        15.0,
    )
    assert file.home == HOME
    assert [each.number for each in file.items] == [1, 2]
    item = file.items[1].item
    assert (item.command, item.frame, item.z) == (WAYPOINT, 3, 20.0)
    assert (item.x / 1e7, item.y / 1e7) == pytest.approx(at(30, 40), abs=1e-7)
    assert math.isnan(item.parameters[3])
    assert shape(file.fence) == [(True, 3, 0.0), (False, 1, 200.0)]
    assert [point.height for point in file.rally] == [7.0]


def test_survey_contributes_its_items():
    inner = [simple(WAYPOINT, 10 * n, 0, doJumpId=n) for n in (2, 3, 4)]
    file = read(plan(simple(TAKEOFF, doJumpId=1), survey(*inner), simple(LAND, doJumpId=5)))
    transects = [(number, WAYPOINT, "survey 2") for number in (2, 3, 4)]
    assert commands(file) == [(1, TAKEOFF, ""), *transects, (5, LAND, "")]
    assert [len(area) for area in file.areas] == [3]
    corridor = {**survey(*inner), "complexItemType": "CorridorScan"}
    assert len(read(plan(corridor)).items) == 3
    assert len(read(plan(survey(*inner, version=None))).items) == 3


_STOP = [(206, 0.0), (2001, 0.0)]


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        (landing(), [189, 31, 21]),
        (landing("vtolLandingPattern"), [189, 31, 85]),
        (landing(useLoiterToAlt=False), [189, 16, 21]),
        (landing(stopTakingPhotos=True, stopVideoPhotos=True), [189, 206, 2001, 2501, 31, 21]),
        (landing(useDoChangeSpeed=True, finalApproachSpeed=12), [189, 178, 31, 21]),
    ],
)
def test_landing_pattern_is_expanded(pattern, expected):
    file = read(plan(simple(TAKEOFF), pattern, vehicle=VTOL))
    assert [each.item.command for each in file.items] == [TAKEOFF, *expected]
    assert {each.part_of for each in file.items[1:]} == {"landing pattern 2"}
    approach, touchdown = file.items[-2].item, file.items[-1].item
    assert (approach.z, approach.frame) == (40.0, dialect.MAV_FRAME_GLOBAL_RELATIVE_ALT)
    assert (touchdown.x / 1e7, touchdown.y / 1e7) == pytest.approx(at(0, 0), abs=1e-7)
    if approach.command == 31:
        assert approach.parameters == (1.0, -30.0, 0.0, 1.0)


def test_landing_pattern_of_version_1_is_read():
    old = landing(version=1, loiterAltitudeRelative=False, landAltitudeRelative=False, loiterClockwise=True)
    old["loiterCoordinate"] = old.pop("landingApproachCoordinate")
    del old["altitudesAreRelative"]
    items = read(plan(old)).items
    assert {each.item.frame for each in items[1:]} == {dialect.MAV_FRAME_GLOBAL}
    assert items[1].item.parameters[1] == 30.0


def test_jump_target_is_converted_to_the_item_number():
    jump = simple(177, p=(7, 2, 0, 0), frame=2, doJumpId=9)
    file = read(plan(simple(TAKEOFF, doJumpId=5), simple(WAYPOINT, doJumpId=7), jump))
    assert file.items[2].item.parameters[:2] == (2.0, 2.0)
    assert [item.parameters[0] for item in file.mission(px4=False)][2] == 2.0
    assert [item.parameters[0] for item in file.mission(px4=True)][2] == 1.0


def test_missing_coordinates_mean_the_current_position():
    without_place = simple(TAKEOFF)
    without_place["params"][4:6] = [None, None]
    file = read(plan(without_place))
    item = file.items[0].item
    assert (item.x, item.y) == (HERE, HERE)
    assert [(each.x, each.y) for each in file.mission(px4=True)] == [(HERE, HERE)]
    # ArduPilot uses 0, 0 for its own position, and refuses other positions that are not on the Earth.
    assert [(each.x, each.y) for each in file.mission(px4=False)] == [(0, 0)]
    # In MAV_FRAME_MISSION parameters 5 and 6 are numbers.
    numbers = {**simple(203, frame=2), "params": [0, 0, 0, 0, 1, 2, 3]}
    item = read(plan(numbers)).items[0].item
    assert (item.x, item.y, item.z) == (1, 2, 3.0)


@pytest.mark.parametrize(
    ("mission", "home"),
    [
        ({"plannedHomePosition": None}, None),
        ({"plannedHomePosition": [None, None, None]}, None),
        ({"plannedHomePosition": [47.0, 8.0]}, 0.0),
        ({"plannedHomePosition": [47.0, 8.0, None]}, 0.0),
    ],
)
def test_missing_home_or_home_altitude_is_accepted(mission, home):
    file = read(plan(simple(TAKEOFF), **mission))
    assert (None if file.home is None else file.home.altitude) == home


def test_unknown_vehicle_and_firmware_are_read_as_empty():
    file = read(plan(simple(TAKEOFF), firmware=0, vehicle=0))
    assert (file.kind, file.firmware) == ("", "")


def test_fence_of_version_1_is_read():
    tree = json.loads(plan(simple(TAKEOFF)))
    tree["geoFence"] = {
        "version": 1,
        "polygon": zone((0, 0), (0, 9), (9, 9))["polygon"],
        "breachReturn": [47.0, 8.0],
    }
    (only,) = read(json.dumps(tree).encode()).fence
    assert (only.inclusion, len(only.corners)) == (True, 3)


_TAKEOFF = simple(TAKEOFF)


@pytest.mark.parametrize(
    ("items", "number"),
    [
        ([_TAKEOFF, {"type": "ComplexItem", "complexItemType": "StructureScan"}], 2),
        ([_TAKEOFF, {"type": "ComplexItem", "complexItemType": "VTOLTakeoff"}], 2),
        ([_TAKEOFF, {"type": "ComplexItem", "complexItemType": "survey", "version": 3, "grid": {}}], 2),
        ([survey(_TAKEOFF, _TAKEOFF), survey(version=7)], 3),
        ([_TAKEOFF, survey(version="1")], 2),
        ([survey(_TAKEOFF, {"command": 16}), _TAKEOFF], 2),
        ([_TAKEOFF, landing(landCoordinate=[47.0, 8.0])], 2),
        ([_TAKEOFF, {**landing(), "loiterRadius": "wide"}], 2),
        ([_TAKEOFF, {"type": "missionItem"}], 2),
        ([_TAKEOFF, 5], 2),
        ([{**_TAKEOFF, "command": "takeoff"}], 1),
        ([{**_TAKEOFF, "command": 70_000}], 1),
        ([{**_TAKEOFF, "frame": -1}], 1),
        ([_TAKEOFF, {**_TAKEOFF, "params": [0, 0, 0, 0, 47.0, 8.0]}], 2),
        ([_TAKEOFF, {**_TAKEOFF, "params": [0, 0, 0, 0, 1e9, 8.0, 10]}], 2),
        ([_TAKEOFF, {**_TAKEOFF, "params": ["a", 0, 0, 0, 47.0, 8.0, 10]}], 2),
        ([_TAKEOFF, {**_TAKEOFF, "params": [1e39, 0, 0, 0, 47.0, 8.0, 10]}], 2),
        ([_TAKEOFF, {**_TAKEOFF, "params": [0, 0, 0, 0, 47.0, 8.0, -1e300]}], 2),
    ],
)
def test_malformed_item_is_refused_with_its_number(items, number):
    assert refusal(plan(*items)).item == number


@pytest.mark.parametrize(
    "change",
    [
        {"fileType": "Mission"},
        {"version": 2},
        {"mission": {"version": 1, "items": []}},
        {"mission": None},
        {"mission": {"version": 2, "items": [], "plannedHomePosition": [97.0, 8.0, 0.0]}},
        {"geoFence": {"version": 3}},
        {"geoFence": {"polygons": [{"polygon": [[1]]}]}},
        {"geoFence": {"circles": [{"circle": {"center": [97.0, 8.0], "radius": 5}}]}},
        {"rallyPoints": {"points": [[None, 8.0, 5]]}},
    ],
)
def test_plan_of_another_structure_is_refused(change):
    tree = json.loads(plan(_TAKEOFF))
    assert refusal(json.dumps({**tree, **change}).encode()).item is None


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"\xff{}",
        b'{"fileType": "Plan", "version": 1, "mission": {"version": 2, "items": [NaN]}}',
        b'{"mission": ' + b"[" * 100_000,
        plan(_TAKEOFF).decode().encode("utf-16"),
        plan(_TAKEOFF)[:-30],
        plan(_TAKEOFF).replace(b"QGroundControl", b"QGroundControl\xe9"),
        b"\x00" * 1000,
    ],
)
def test_invalid_plan_bytes_are_refused(data):
    refusal(data)


def test_byte_order_mark_and_crlf_are_accepted():
    data = json.dumps(json.loads(plan(_TAKEOFF)), indent=1).replace("\n", "\r\n").encode()
    assert len(read(b"\xef\xbb\xbf" + data).items) == 1


# -- QGC WPL --------------------------------------------------------------------------------------------

_UP = (3, TAKEOFF, 0, 0, 0, 0, 0.0, 0.0, 10.0)
_GO = (3, WAYPOINT, 0, 0, 0, 0, 30.0, 40.0, 20.0)


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\n\n"])
def test_waypoint_file_is_read(newline):
    file = read(rows(_UP, _GO, newline=newline))
    assert (file.kind, file.firmware) == ("", "")
    assert file.home.latitude == pytest.approx(HOME.latitude)
    assert file.home.altitude == 488.0
    assert commands(file) == [(1, TAKEOFF, ""), (2, WAYPOINT, "")]
    item = file.items[1].item
    assert (item.x / 1e7, item.y / 1e7) == pytest.approx(at(30, 40), abs=1e-7)
    assert item.z == 20.0


def test_waypoint_file_without_home_is_read():
    assert read(rows(_UP, _GO, home=None)).home is None
    assert commands(read(rows(_UP, _GO, home=None)))[0] == (0, TAKEOFF, "")
    assert commands(read(rows(_GO, _GO, home=None, version=120)))[0] == (0, WAYPOINT, "")
    unknown = rows(_UP).replace(f"{HOME.latitude:.8f}\t{HOME.longitude:.8f}".encode(), b"0\t0", 1)
    assert read(unknown).home is None
    blank = rows(_UP).replace(b"0\t1\t0\t16\t", b"0\t1\t0\t0\t", 1)
    assert commands(read(blank)) == [(1, TAKEOFF, "")]


def test_waypoint_file_with_comments_spaces_and_decimals_is_read():
    head = "\ufeffQGC WPL 110 \n# by hand\n0 1 0 16.0 0 0 0 0 47.0 8.0 400 1\n"
    file = read((head + "1 0 3.000000 22 0 0 0 0 0 0 10.5 1\n").encode())
    assert file.items[0].item.z == 10.5


def test_jump_target_in_a_file_numbered_from_0_is_converted():
    jump = (2, 177, 1, 3, 0, 0, 0.0, 0.0, 0.0)
    file = read(rows(_UP, _GO, jump, home=None, version=120))
    assert [item.parameters[0] for item in file.mission(px4=True)][2] == 1.0
    assert [item.parameters[0] for item in file.mission(px4=False)][2] == 2.0


def test_fence_and_rally_points_in_a_waypoint_file_are_read():
    corners = [(3, 5001, 3, 0, 0, 0, *corner, 0.0) for corner in ((0.0, 0.0), (0.0, 50.0), (50.0, 50.0))]
    file = read(rows(*corners, (3, 5004, 20, 0, 0, 0, 5.0, 5.0, 0.0), (3, 5100, 0, 0, 0, 0, 1.0, 1.0, 30.0)))
    assert file.items == ()
    assert shape(file.fence) == [(True, 3, 0.0), (False, 1, 20.0)]
    assert [point.height for point in file.rally] == [30.0]
    assert refusal(rows(*corners[:2])).item == 2


@pytest.mark.parametrize(
    ("data", "where"),
    [
        (b"QGC WPL 100\n", "line 1"),
        (b"QGC WPL\n", "line 1"),
        (b"QGC MPL 110\n", "line 1"),
        (rows(_UP).replace(b"\t1\n", b"\n"), "line 2"),
        (rows(_UP, _GO).replace(b"20.0", b"high"), "line 4"),
        (rows(_UP, _GO).replace(b"20.0", b"inf"), "line 4"),
        (rows(_UP, _GO).replace(b"20.0", b"2_0"), "line 4"),
        (rows(_UP, _GO).replace(b"\t16\t", b"\t1_6\t"), "line 2"),
        (rows(_UP, _GO).replace(b"\n2\t", b"\n5\t"), "line 4"),
        (rows(_UP, _GO).replace(b"\t16\t", b"\t16.5\t"), "line 2"),
        (rows(_UP, _GO).replace(b"\t22\t", b"\tinf\t"), "line 3"),
        (rows(_UP, _GO).replace(b"\t22\t", b"\t-5\t"), "line 3"),
        (b"QGC WPL 110\n\xff\n", ""),
    ],
)
def test_malformed_waypoint_file_is_refused_with_its_line(data, where):
    assert refusal(data).where == where


def test_other_text_is_refused():
    assert "neither" in refusal(b"hello").fault
