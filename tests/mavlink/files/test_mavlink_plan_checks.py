"""Checks of a plan for a vehicle: all findings, with the item's number in the ground station."""

from __future__ import annotations

import math

import pytest
from plan_texts import (
    HOME,
    LAND,
    PLANE,
    RETURN,
    ROVER,
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

from lfield.driver import PlanRequest
from lfield_mavlink.files.plan_report import MOST_ITEMS, ON_BOARD, read_plan
from lfield_mavlink.link.dialect import dialect

LIMITS = {"radius": 100.0, "altitude": 30.0, "speed": 6.0}
UP = simple(TAKEOFF)


def report(data, kind="copter", firmware="", limits=LIMITS, home=None):
    return read_plan("f.plan", data, PlanRequest(kind, firmware, limits, home))


def found(data, **request):
    return [(finding.code, finding.item) for finding in report(data, **request).findings]


@pytest.mark.parametrize(
    ("height", "radius", "items"), [(0, 0, []), (30, 60, []), (31, 0, [3]), (0, 61, [2])]
)
def test_stated_return_height_and_circle_radius_are_checked(height, radius, items):
    turns = simple(dialect.MAV_CMD_NAV_LOITER_TURNS, 40, 0, 20.0, p=(1.0, 0.0, 0.0, None))
    options = {"return_height": float(height), "circle_radius": float(radius)}
    request = PlanRequest("copter", "", LIMITS, options=options)
    read = read_plan("f.plan", plan(UP, turns, simple(RETURN, frame=2)), request)
    assert [(each.code, each.item) for each in read.findings] == [("M104", item) for item in items]


def test_correct_plan_has_no_findings_and_an_estimate():
    points = [(0, 0, 10.0), (40, 30, 20.0), (40, 0, 20.0)]
    items = [UP, *(simple(WAYPOINT, *point) for point in points[1:]), simple(RETURN, frame=2)]
    read = report(
        plan(*items, polygons=[zone((-90, -90), (-90, 90), (90, 90), (90, -90))], rally=[(9, 9, 5.0)])
    )
    assert read.findings == ()
    assert read.is_usable
    assert (read.items, read.kind, read.firmware) == (4, "copter", "ardupilot")
    # 10 m up, 51 m to item 2, 30 m to item 3, 40 m back.
    assert read.length == pytest.approx(10.0 + math.hypot(50.0, 10.0) + 30.0 + 40.0, abs=0.5)
    assert read.duration == pytest.approx(read.length / 5.0, rel=1e-6)
    assert report(plan(*items, hoverSpeed=-1)).duration == read.duration
    assert read.highest == (20.0, 2)
    assert read.farthest == (pytest.approx(50.0, abs=0.1), 2)
    assert [point.item for point in read.path] == [1, 2, 3, 4]
    assert (len(read.zones), len(read.rally)) == (1, 1)


def test_every_finding_is_reported_in_item_order():
    items = [
        simple(WAYPOINT),
        simple(WAYPOINT, 500.0),
        simple(WAYPOINT, height=-3.0),
        simple(WAYPOINT, height=80.0),
        simple(31_999),
        simple(178, p=(1.0, 9.0, 0, 0), frame=2),
        simple(177, p=(44.0, 1.0, 0, 0), frame=2),
        simple(81),
    ]
    assert found(plan(*items)) == [
        ("M108", 1), ("M104", 2), ("M107", 3), ("M104", 4), ("M103", 5),
        ("M104", 6), ("M104", 7), ("M104", 8),
    ]  # fmt: skip
    half = simple(WAYPOINT)
    half["params"][4] = None
    assert found(plan(UP, half, simple(177, p=(1.5, 1.0, 0, 0), frame=2))) == [("M104", 2), ("M104", 3)]
    texts = [finding.text for finding in report(plan(*items)).findings]
    assert texts[1].startswith("waypoint 2 refused")
    assert "item 44" in texts[6]


def test_finding_in_a_survey_names_the_survey():
    (finding,) = report(plan(UP, survey(simple(WAYPOINT), simple(WAYPOINT, 400.0)))).findings
    assert finding.item == 3
    assert finding.text.endswith("(of the survey 2)")


@pytest.mark.parametrize(
    ("made_for", "asked", "code"),
    [
        ({"vehicle": ROVER}, {"kind": "copter"}, ["M101"]),
        ({"vehicle": PLANE}, {"kind": "copter"}, ["M101"]),
        ({"vehicle": VTOL}, {"kind": "copter"}, ["M101"]),
        ({"vehicle": VTOL}, {"kind": "vtol"}, []),
        ({"vehicle": VTOL}, {"kind": "plane"}, []),
        ({"vehicle": PLANE}, {"kind": "vtol"}, ["M101"]),
        ({"vehicle": 0}, {"kind": "copter"}, []),
        ({"vehicle": ROVER}, {"kind": ""}, []),
        ({"firmware": 12}, {"firmware": "ardupilot"}, ["M102"]),
        ({"firmware": 3}, {"firmware": "px4"}, ["M102"]),
        ({"firmware": 12}, {"firmware": "px4"}, []),
        ({"firmware": 0}, {"firmware": "px4"}, []),
        ({"firmware": 3, "vehicle": ROVER}, {"firmware": "px4"}, ["M101", "M102"]),
    ],
)
def test_plan_for_another_vehicle_or_firmware_is_refused(made_for, asked, code):
    assert [each for each, _ in found(plan(UP, **made_for), **asked)] == code


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("firmware", "count", "codes"),
    [
        (12, 500, []),
        (12, 501, ["M105"]),
        (12, 10_000, ["M105"]),
        (3, ON_BOARD, []),
        (3, ON_BOARD + 1, ["M902"]),
        (3, MOST_ITEMS["ardupilot"] + 1, ["M105"]),
        (3, 10_000, ["M105"]),
        (0, 10_000, ["M105"]),
        (3, 0, ["M105"]),
    ],
)
def test_item_count_limits_by_firmware(firmware, count, codes):
    items = [UP, *[simple(WAYPOINT, 10.0)] * (count - 1)][:count]
    assert [code for code, _ in found(plan(*items, firmware=firmware))] == codes


def test_plan_with_a_fence_only_has_no_findings():
    assert found(plan(polygons=[zone((0, 0), (0, 9), (9, 9))]), limits={}) == []


def test_limits_need_a_home_position():
    without = plan(UP, simple(WAYPOINT, 50.0), plannedHomePosition=None)
    assert found(without) == [("M109", None)]
    assert found(without, limits={}) == []
    assert found(without, home=(HOME.latitude, HOME.longitude, 0.0)) == []
    # A home position that differs from the file's.
    assert found(plan(UP, simple(WAYPOINT, 50.0)), home=(*at(-80.0, 0.0), 0.0)) == [("M104", 2)]


def test_home_far_from_the_first_item_gives_a_warning():
    assert found(plan(simple(TAKEOFF, 1000.0)), limits={}) == [("M901", 1)]
    assert report(plan(simple(TAKEOFF, 1000.0)), limits={}).is_usable


@pytest.mark.parametrize(
    ("kind", "vehicle", "needs"), [("copter", 2, True), ("plane", 1, True), ("rover", 10, False)]
)
def test_plan_of_a_flying_vehicle_needs_a_takeoff(kind, vehicle, needs):
    camera = simple(206, p=(5.0, 0, 0, 0), frame=2)
    data = plan(camera, simple(WAYPOINT), vehicle=vehicle)
    assert found(data, kind=kind) == ([("M108", 2)] if needs else [])
    assert found(plan(camera, UP, simple(WAYPOINT), vehicle=vehicle), kind=kind) == []


def test_only_landings_and_rovers_may_be_below_home():
    assert found(plan(UP, simple(LAND, height=-4.0))) == []
    assert found(plan(simple(WAYPOINT, height=-4.0), vehicle=ROVER), kind="rover") == []
    sea = simple(WAYPOINT, height=HOME.altitude - 1.0, frame=0)
    assert found(plan(UP, sea)) == [("M107", 2)]


def test_terrain_heights_are_refused_only_with_an_altitude_limit():
    terrain = simple(WAYPOINT, frame=10)
    assert found(plan(UP, terrain)) == [("M104", 2)]
    assert found(plan(UP, terrain), limits={"radius": 100.0}) == []


def test_vtol_landing_pattern_is_checked_against_the_limits():
    items = [simple(84), simple(WAYPOINT, 80.0), landing("vtolLandingPattern")]
    data = plan(*items, vehicle=VTOL)
    assert found(data, kind="vtol", limits={"radius": 200.0, "altitude": 50.0}) == []
    # The circle of the approach is 100 m away and has a radius of 30 m; it is 40 m high.
    assert found(data, kind="vtol", limits={"radius": 129.0, "altitude": 50.0}) == [("M104", 4)]
    assert found(data, kind="vtol", limits={"altitude": 39.0}) == [("M104", 4)]


# -- the plan's fence ----------------------------------------------------------------------------------------

_FIELD = zone((-60, -60), (-60, 60), (60, 60), (60, -60))


@pytest.mark.parametrize(
    ("items", "fence", "faults"),
    [
        ([(50, 0)], {"polygons": [_FIELD]}, []),
        ([(70, 0)], {"polygons": [_FIELD]}, [("M106", 2)]),
        ([(50, 0)], {"circles": [circle(60.0)]}, []),
        ([(70, 0)], {"circles": [circle(60.0)]}, [("M106", 2)]),
        ([(30, 0)], {"circles": [circle(10.0, 30, 0, inclusion=False)]}, [("M106", 2)]),
        # Through a zone, or past it.
        ([(50, 0)], {"circles": [circle(10.0, 30, 0, inclusion=False)]}, [("M106", 2)]),
        ([(50, 0)], {"circles": [circle(10.0, 30, 11, inclusion=False)]}, []),
        ([(50, 0)], {"polygons": [zone((20, -5), (20, 5), (25, 0), inclusion=False)]}, [("M106", 2)]),
        ([(50, 0)], {"polygons": [zone((20, 5), (20, 9), (25, 7), inclusion=False)]}, []),
        # Out of a zone between two points in it: a U.
        (
            [(50, 40), (50, -40)],
            {"polygons": [zone((-9, -60), (-9, 60), (60, 60), (60, 30), (9, 0), (60, -30), (60, -60))]},
            [("M106", 3)],
        ),
        # Home is outside.
        ([(50, 0)], {"polygons": [zone((5, -60), (5, 60), (60, 60), (60, -60))]}, [("M106", 0), ("M106", 1)]),
    ],
)
def test_items_and_legs_outside_the_fence_are_found(items, fence, faults):
    data = plan(UP, *(simple(WAYPOINT, *place) for place in items), **fence)
    assert found(data, limits={}) == faults


def test_legs_of_a_jump_are_checked_against_the_fence():
    notch = zone((-9, -60), (-9, 60), (60, 60), (60, 30), (9, 0), (60, -30), (60, -60))
    items = [UP, simple(WAYPOINT, 50, 40), simple(WAYPOINT, 0, 0), simple(WAYPOINT, 50, -40)]
    jump = simple(177, p=(2.0, 3.0, 0, 0), frame=2)
    assert found(plan(*items, polygons=[notch]), limits={}) == []
    assert found(plan(*items, jump, polygons=[notch]), limits={}) == [("M106", 2)]


def test_ardupilot_needs_all_inclusion_zones_and_px4_one():
    """ArduPilot must be inside all zones, PX4 inside one."""
    zones = [_FIELD, zone((-60, -60), (-60, 10), (60, 10), (60, -60))]
    items = [UP, simple(WAYPOINT, 50, -30), simple(WAYPOINT, 50, 30)]
    assert found(plan(*items, polygons=zones), limits={}) == [("M106", 3)]
    assert found(plan(*items, polygons=zones, firmware=12), limits={}) == []


@pytest.mark.parametrize(
    "fence",
    [
        {"polygons": [zone((0, 0), (9, 9))]},
        {"polygons": [zone((0, 0), (9, 9), (9, 0), (0, 9))]},
        {"circles": [circle(0.0)]},
        {"circles": [circle(-5.0)]},
        {"polygons": [zone(*[(each, each * each) for each in range(300)])]},
    ],
)
def test_invalid_fence_zones_are_found(fence):
    assert found(plan(UP, **fence)) == [("M110", None)]


def test_rally_points_outside_limits_or_fence_are_found():
    rally = [(10, 0, 5.0), (500, 0, 5.0), (10, 0, 80.0), (10, 0, 5.0)]
    read = report(plan(UP, rally=rally))
    assert [finding.code for finding in read.findings] == ["M111", "M111"]
    assert read.findings[0].text.startswith("rally point 2")
    outside = report(plan(UP, rally=[(70, 0, 5.0)], polygons=[_FIELD]))
    assert [finding.code for finding in outside.findings] == ["M111"]


# -- other formats ----------------------------------------------------------------------------------------


def test_waypoint_file_items_are_numbered_with_or_without_home():
    up, go = (3, TAKEOFF, 0, 0, 0, 0, 0.0, 0.0, 10.0), (3, WAYPOINT, 0, 0, 0, 0, 400.0, 0.0, 10.0)
    assert found(rows(up, go)) == [("M104", 2)]
    without = rows(up, go, home=None)
    assert found(without, home=(HOME.latitude, HOME.longitude, 0.0)) == [("M104", 1)]


def test_duration_estimate_counts_speed_changes_and_waits():
    items = [
        UP,
        simple(178, p=(1.0, 2.0, 0, 0), frame=2),
        simple(WAYPOINT, 100.0, p=(7.0, 0, 0, None)),
        simple(93, p=(11.0, 0, 0, 0), frame=2),
    ]
    assert report(plan(*items), limits={}).duration == pytest.approx(10 / 5 + 100 / 2 + 7 + 11, abs=0.1)
    fast = [UP, simple(178, p=(1.0, 50.0, 0, 0), frame=2), simple(WAYPOINT, 100.0)]
    assert report(plan(*fast), limits={"speed": 10.0}).duration == pytest.approx(10 / 5 + 100 / 10, abs=0.1)
    cruise = report(plan(UP, simple(WAYPOINT, 150.0), vehicle=PLANE), kind="plane", limits={}).duration
    assert cruise == pytest.approx(160.0 / 15.0, abs=0.1)
