"""Missions inside or beyond the limits, item by item: the rules alone, without a vehicle."""

from __future__ import annotations

import math
import struct

import pytest

from lfield.driver import DeviceError
from lfield.testing.driver_bench import bind
from lfield_mavlink import PLUGIN
from lfield_mavlink.geodesy import Place
from lfield_mavlink.limits import Limits
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.services.mission_check import HERE, Climb, Situation
from lfield_mavlink.services.mission_commands import starts_with_takeoff
from lfield_mavlink.services.mission_paths import arc_corners, spline_corners
from lfield_mavlink.services.mission_rules import RULES, check_mission
from lfield_mavlink.services.plan_items import Item, place

HOME = Place(47.397742, 8.545594, 488.0)
ALL = {"radius": 100.0, "altitude": 30.0, "speed": 5.0}
NAN = math.nan
SEA, ABOVE_HOME, TERRAIN, MISSION, LOCAL = 0, 6, 11, 2, 1


def item(name, north=0.0, east=0.0, height=10.0, frame=ABOVE_HOME, p=(0.0, 0.0, 0.0, 0.0)):
    """The item MAV_CMD_`name` at metres from home, with the first parameters of `p`."""
    there = HOME.shifted((north, east, 0.0))
    parameters = (*p, 0.0, 0.0, 0.0, 0.0)[:4]
    number = name if isinstance(name, int) else getattr(dialect, f"MAV_CMD_{name}")
    return Item(number, frame, *place(there.latitude, there.longitude), height, parameters)


def refusal(*items, limits=ALL, **about):
    """The reason for refusing a mission, '' if it is accepted."""
    binding = bind(PLUGIN, limits=limits, options={"system": 1})
    situation = Situation(
        **{"kind": "copter", "px4": False, "home": HOME, "position": (0.0, 0.0, -5.0)} | about
    )
    try:
        check_mission("m", items, Limits(binding, lambda why: DeviceError("fc", why)), _error, situation)
    except DeviceError as error:
        return error.reason
    return ""


def _error(reason):
    return DeviceError("fc", reason)


PLACED = [
    "NAV_WAYPOINT",
    "NAV_LOITER_UNLIM",
    "NAV_LOITER_TIME",
    "NAV_LOITER_TO_ALT",
    "NAV_LAND",
    "NAV_VTOL_LAND",
    "NAV_TAKEOFF",
    "NAV_VTOL_TAKEOFF",
    "NAV_PAYLOAD_PLACE",
    "NAV_SPLINE_WAYPOINT",
    "NAV_ARC_WAYPOINT",
    "DO_REPOSITION",
    "DO_ORBIT",
]


@pytest.mark.parametrize("name", PLACED)
def test_item_with_a_position_is_checked_against_all_limits(name):
    assert refusal(item(name, 50.0)) == ""
    assert "beyond the limit of 100 m" in refusal(item(name, 1000.0))
    assert "beyond the limit of 100 m" in refusal(item(name, 80.0, 80.0))
    assert "above the limit of 30 m" in refusal(item(name, 50.0, height=200.0))
    assert "above the limit of 30 m" in refusal(item(name, 50.0, height=HOME.altitude + 31.0, frame=SEA))
    assert refusal(item(name, 50.0, height=HOME.altitude + 29.0, frame=SEA)) == ""
    assert "is not known" in refusal(item(name, 50.0, frame=LOCAL))
    assert "is not known" in refusal(item(name, 50.0, frame=MISSION))
    lands = name in ("NAV_LAND", "NAV_VTOL_LAND")
    assert ("height of this item is not known" in refusal(item(name, 50.0, frame=TERRAIN))) != lands
    assert ("height of this item is not known" in refusal(item(name, 50.0, height=NAN))) != lands
    assert "home position is unknown" in refusal(item(name, 50.0), home=None)
    assert refusal(item(name, 1000.0, height=200.0), limits={"speed": 5.0}) == ""
    assert refusal(item(name, 1000.0, height=200.0), limits={}) == ""
    assert refusal(item(name, 50.0, frame=TERRAIN), limits={"radius": 100.0}) == ""


@pytest.mark.parametrize("name", ["NAV_TAKEOFF", "NAV_LAND", "NAV_WAYPOINT"])
def test_item_without_coordinates_means_the_current_position(name):
    number = getattr(dialect, f"MAV_CMD_{name}")
    assert refusal(Item(number, ABOVE_HOME, HERE, HERE, 10.0)) == ""
    assert refusal(Item(number, ABOVE_HOME, 0, 0, 10.0)) == ""
    # For PX4 latitude and longitude 0 are a position.
    assert "beyond" in refusal(Item(number, ABOVE_HOME, 0, 0, 10.0), px4=True)
    assert "above" in refusal(Item(number, ABOVE_HOME, HERE, HERE, 31.0))


@pytest.mark.parametrize(
    ("bad", "good"),
    [
        # Circles: the radius counts.
        (item("NAV_LOITER_TURNS", 80.0, p=(1.0, 0.0, 30.0)), item("NAV_LOITER_TURNS", 80.0, p=(1, 0, 15.0))),
        (item("NAV_LOITER_TURNS", 80.0, p=(1.0, 0.0, -30.0)), item("NAV_LOITER_TURNS", 80.0, p=(1, 0, -9.0))),
        (item("DO_ORBIT", 80.0, p=(30.0, 2.0)), item("DO_ORBIT", 80.0, p=(15.0, 2.0))),
        (Item(34, ABOVE_HOME, HERE, HERE, 10.0, (15.0, 2.0, 0.0, 0.0)), item("DO_ORBIT", p=(15.0, 2.0))),
        (item("NAV_WAYPOINT", 90.0, p=(0.0, 0.0, 20.0)), item("NAV_WAYPOINT", 90.0, p=(0.0, 0.0, 5.0))),
        # Speeds.
        (item("DO_ORBIT", 10.0, p=(15.0, 6.0)), item("DO_ORBIT", 10.0, p=(15.0, 5.0))),
        (item("DO_ORBIT", 10.0, p=(15.0, NAN)), item("DO_ORBIT", 10.0, p=(15.0, 0.0))),
        (item("DO_REPOSITION", 10.0, p=(6.0,)), item("DO_REPOSITION", 10.0, p=(-1.0,))),
        (item("DO_CHANGE_SPEED", p=(1.0, 5.1)), item("DO_CHANGE_SPEED", p=(1.0, 5.0))),
        (item("DO_CHANGE_SPEED", p=(0.0, 9.0)), item("DO_CHANGE_SPEED", p=(0.0, -1.0, -1.0))),
        (item("DO_CHANGE_SPEED", p=(1.0, -2.0)), item("DO_CHANGE_SPEED", p=(2.0, 9.0))),
        (item("DO_CHANGE_SPEED", p=(4.0, 1.0)), item("DO_CHANGE_SPEED", p=(3.0, 9.0))),
        (item("DO_CHANGE_SPEED", p=(1.0, NAN)), item("DO_CHANGE_SPEED", p=(1.0, 2.0))),
        # Heights in other parameters.
        (item("NAV_LAND", 10.0, p=(40.0,)), item("NAV_LAND", 10.0, p=(20.0,))),
        (item("NAV_VTOL_LAND", 10.0, p=(0.0, 0.0, 40.0)), item("NAV_VTOL_LAND", 10.0, p=(0.0, 0.0, NAN))),
        (item("DO_CHANGE_ALTITUDE", p=(40.0, 3.0)), item("DO_CHANGE_ALTITUDE", p=(20.0, 3.0))),
        (item("DO_CHANGE_ALTITUDE", p=(20.0, 10.0)), item("DO_CHANGE_ALTITUDE", p=(500.0, 0.0))),
        (item("CONDITION_CHANGE_ALT", height=40.0), item("CONDITION_CHANGE_ALT", height=20.0)),
        (item("DO_GUIDED_LIMITS", p=(0, 0, 530.0)), item("DO_GUIDED_LIMITS", p=(0, 0, 510.0, 50.0))),
        (item("DO_GUIDED_LIMITS", p=(0, 0, 0, 101.0)), item("DO_GUIDED_LIMITS", p=(0, 0, 0, 100.0))),
        # Removal of a protection.
        (item("DO_FENCE_ENABLE", p=(0.0,)), item("DO_FENCE_ENABLE", p=(1.0,))),
        (item("NAV_CONTINUE_AND_CHANGE_ALT"), item("NAV_DELAY", p=(3.0,), frame=MISSION)),
        (item("DO_SET_HOME", 10.0), item("DO_SET_ROI", 5000.0)),
        (item("DO_SET_HOME", p=(1.0,)), item("DO_LAND_START", 5000.0)),
    ],
)
def test_item_parameters_are_checked_against_the_limits(bad, good):
    assert refusal(bad) != ""
    assert refusal(good) == ""
    assert refusal(bad, limits={}) == ""


def on_the_wire(value):
    """The value as a 32-bit float, which may be larger."""
    return struct.unpack("f", struct.pack("f", value))[0]


@pytest.mark.parametrize("limit", [2.7, 5.4, 0.1, 12.3, 25.6])
def test_value_at_its_limit_is_accepted_despite_float32_rounding(limit):
    speed = item("DO_CHANGE_SPEED", p=(1.0, on_the_wire(limit)))
    assert refusal(speed, limits={"speed": limit}) == ""
    assert "above the limit" in refusal(
        item("DO_CHANGE_SPEED", p=(1.0, limit + 1e-3)), limits={"speed": limit}
    )
    for frame, base in ((ABOVE_HOME, 0.0), (SEA, HOME.altitude)):
        high = item("NAV_WAYPOINT", height=on_the_wire(base + limit), frame=frame)
        assert refusal(high, limits={"altitude": limit}) == ""
        higher = item("NAV_WAYPOINT", height=base + limit + 0.01, frame=frame)
        assert "above the limit" in refusal(higher, limits={"altitude": limit})
    assert refusal(item("NAV_WAYPOINT", -limit), limits={"radius": limit}) == ""
    assert "beyond" in refusal(item("NAV_WAYPOINT", -limit - 0.05), limits={"radius": limit})


@pytest.mark.parametrize("kind", [0.0, 1.0, 2.0, 3.0])
def test_every_speed_type_is_limited_for_a_rover(kind):
    assert "above the limit" in refusal(item("DO_CHANGE_SPEED", p=(kind, 6.0)), kind="rover")
    assert refusal(item("DO_CHANGE_SPEED", p=(kind, 5.0)), kind="rover") == ""
    assert (refusal(item("DO_CHANGE_SPEED", p=(kind, 6.0)), kind="plane") == "") is (kind > 1.0)


def test_change_of_home_is_refused_only_with_position_limits():
    assert "changes home" in refusal(item("DO_SET_HOME", 10.0), limits={"altitude": 30.0})
    assert refusal(item("DO_SET_HOME", 10.0), limits={"speed": 5.0}) == ""


def test_continuing_climb_is_accepted_with_only_a_height_limit():
    only = {"altitude": 30.0}
    assert refusal(item("NAV_CONTINUE_AND_CHANGE_ALT", height=20.0), limits=only) == ""
    assert "above" in refusal(item("NAV_CONTINUE_AND_CHANGE_ALT", height=31.0), limits=only)


@pytest.mark.parametrize("limits", [{"radius": 100.0}, {"altitude": 30.0}, {"speed": 5.0}])
def test_command_without_a_rule_is_refused_under_any_limit(limits):
    numbers = [*sorted(set(dialect.enums["MAV_CMD"]) - set(RULES)), 7, 29999, 65535]
    for number in numbers:
        assert "is not known to stay within the limits" in refusal(item(number), limits=limits)
        assert refusal(item(number), limits={}) == ""


def test_commands_that_hand_over_control_have_no_rule():
    others = "NAV_GUIDED_ENABLE NAV_SCRIPT_TIME NAV_ATTITUDE_TIME NAV_SET_YAW_SPEED NAV_FOLLOW DO_SET_MODE"
    others += " DO_SET_PARAMETER DO_AUX_FUNCTION DO_SEND_SCRIPT_MESSAGE DO_VTOL_TRANSITION DO_GO_AROUND"
    others += " OVERRIDE_GOTO DO_FIGURE_EIGHT NAV_TAKEOFF_LOCAL NAV_LAND_LOCAL DO_PARACHUTE DO_MOTOR_TEST"
    assert not {getattr(dialect, f"MAV_CMD_{name}") for name in others.split()} & set(RULES)


def test_missing_loiter_radius_is_taken_from_the_parameter():
    turns = item("NAV_LOITER_TURNS", 80.0, p=(1.0, 0.0, 0.0))
    assert refusal(turns, loiter=10.0) == ""
    assert "beyond" in refusal(turns, loiter=30.0)
    assert "beyond" in refusal(turns, loiter=None)
    # A fixed wing circles at each loiter.
    assert "beyond" in refusal(item("NAV_LOITER_TIME", 80.0), kind="plane", loiter=60.0)
    assert "beyond" in refusal(item("NAV_LOITER_TO_ALT", 80.0, p=(0.0, 60.0)), kind="plane")


def test_return_climb_and_rally_points_are_checked():
    back = item("NAV_RETURN_TO_LAUNCH", frame=MISSION)
    assert refusal(back, climb=Climb(15.0, "RTL_ALT")) == ""
    assert "RTL_ALT" in refusal(back, climb=Climb(40.0, "RTL_ALT"))
    assert "height of its return is not known" in refusal(back)
    assert refusal(back, limits={"radius": 100.0}) == ""
    assert refusal(back, kind="rover") == ""
    rally = item("NAV_RALLY_POINT", 500.0)
    assert "rally point 0" in refusal(back, climb=Climb(15.0, "RTL_ALT"), rally=[rally])
    near = [item("NAV_RALLY_POINT", 50.0)]
    assert refusal(back, climb=Climb(15.0, "RTL_ALT"), rally=near) == ""
    # PX4 returns at its height above the rally point, which is 10 m up.
    assert refusal(back, climb=Climb(15.0, "RTL_RETURN_ALT"), rally=near, px4=True) == ""
    assert "rally point 0" in refusal(back, climb=Climb(25.0, "RTL_RETURN_ALT"), rally=near, px4=True)


def test_minimum_climb_of_a_return_counts_from_the_highest_item():
    back, climb = item("NAV_RETURN_TO_LAUNCH", frame=MISSION), Climb(15.0, "RTL_ALT", 10.0, "RTL_CLIMB_MIN")
    assert refusal(item("NAV_WAYPOINT", height=20.0), back, climb=climb) == ""
    assert "climb to 31 m (RTL_CLIMB_MIN)" in refusal(item("NAV_WAYPOINT", height=21.0), back, climb=climb)


def test_heights_are_ignored_for_a_rover():
    assert refusal(item("NAV_WAYPOINT", 50.0, height=200.0, frame=TERRAIN), kind="rover") == ""
    assert "beyond" in refusal(item("NAV_WAYPOINT", 500.0), kind="rover")
    assert refusal(item("DO_CHANGE_SPEED", p=(1.0, 2.0, 80.0)), kind="rover") != ""


def test_spline_curve_beyond_its_waypoints_is_checked():
    # The vehicle turns back at 95 m: the incoming direction moves the curve out of the circle.
    bulge = [item("NAV_WAYPOINT", -60.0), item("NAV_WAYPOINT", 0.0), item("NAV_SPLINE_WAYPOINT", 95.0, 0.0)]
    assert refusal(*bulge) == ""
    assert "the curve of item 2" in refusal(*bulge, item("NAV_WAYPOINT", -60.0))
    inside = [item("NAV_WAYPOINT", 0.0), item("NAV_SPLINE_WAYPOINT", 50.0), item("NAV_WAYPOINT", 50.0, 40.0)]
    assert refusal(*inside) == ""
    assert "curve may start is unknown" in refusal(*inside, position=None, starts_here=True)
    assert refusal(*inside, position=None) == ""
    jump = item("DO_JUMP", p=(2.0, 3.0), frame=MISSION)
    assert "a mission with jumps" in refusal(*inside, jump)
    assert refusal(*inside, jump, limits={}) == ""


def test_spline_lies_inside_its_corners():
    before, start, goal, after = (0.0, -20.0, 0.0), (0.0, 0.0, 0.0), (50.0, 0.0, 0.0), (0.0, 10.0, 0.0)
    corners = list(spline_corners(before, start, goal, after))
    begin = tuple(b - a for a, b in zip(before, goal, strict=True))
    end = tuple(b - a for a, b in zip(start, after, strict=True))
    for number in range(101):
        t = number / 100
        h = (2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2)
        point = [
            sum(w * v[axis] for w, v in zip(h, (start, begin, goal, end), strict=True)) for axis in (0, 1)
        ]
        for axis in (0, 1):
            assert min(c[axis] for c in corners) - 1e-9 <= point[axis] <= max(c[axis] for c in corners) + 1e-9


@pytest.mark.parametrize(
    ("degrees", "north", "east"),
    [
        (90.0, (0.0, 10.0), (0.0, 10.0)),
        (-90.0, (0.0, 10.0), (0.0, 10.0)),
        (270.0, (0.0, 20.0), (-10.0, 10.0)),
    ],
)
def test_arc_lies_inside_its_corners(degrees, north, east):
    corners = arc_corners((0.0, 0.0, -5.0), (10.0, 10.0, -8.0), degrees)
    assert corners is not None
    for axis, span in ((0, north), (1, east)):
        values = [corner[axis] for corner in corners]
        assert [min(values), max(values)] == pytest.approx(span, abs=0.05)
        assert min(values) <= span[0] + 1e-9
        assert max(values) >= span[1] - 1e-9


def test_complete_arc_is_checked_against_the_limits():
    start = item("NAV_WAYPOINT", 0.0, -80.0)
    assert refusal(start, item("NAV_ARC_WAYPOINT", 0.0, 80.0, p=(60.0,))) == ""
    assert "the arc of item 1" in refusal(start, item("NAV_ARC_WAYPOINT", 0.0, 80.0, p=(250.0,)))
    for none in (360.0, NAN, math.inf):
        assert "there is no arc" in refusal(start, item("NAV_ARC_WAYPOINT", 0.0, 80.0, p=(none,)))


@pytest.mark.parametrize(
    ("wrong", "px4"),
    [
        (item("DO_JUMP", p=(0.0, 1.0)), False),
        (item("DO_JUMP", p=(3.0, 1.0)), False),
        (item("DO_JUMP", p=(2.0, 1.0)), True),
        (item("DO_JUMP", p=(-1.0, 1.0)), True),
        (item("DO_JUMP", p=(NAN, 1.0)), True),
        (item("DO_SET_MISSION_CURRENT", p=(7.0,)), False),
        (item("DO_JUMP_TAG", p=(3.0, 1.0)), False),
        (Item(16, ABOVE_HOME, 900_000_001, 0, 5.0), False),
        (Item(16, ABOVE_HOME, 0, 1_800_000_001, 5.0), False),
        (item("NAV_WAYPOINT", height=math.inf), False),
    ],
)
def test_malformed_item_is_refused_without_limits(wrong, px4):
    assert "item 1" in refusal(item("NAV_WAYPOINT"), wrong, limits={}, px4=px4)


def test_jump_with_a_valid_target_is_accepted():
    assert refusal(item("NAV_WAYPOINT"), item("DO_JUMP", p=(1.0, 2.0))) == ""
    assert refusal(item("NAV_WAYPOINT"), item("DO_JUMP", p=(0.0, 2.0)), px4=True) == ""
    assert refusal(item("JUMP_TAG", p=(3.0,)), item("DO_JUMP_TAG", p=(3.0, 1.0))) == ""


@pytest.mark.parametrize(
    ("numbers", "begins"),
    [
        ((530, 178, 22, 16), True),
        ((93, 22), True),
        ((84,), True),
        ((112, 203, 2000, 22), True),
        ((201, 80, 22), True),
        ((530, 178, 16, 22), False),
        ((31, 22), False),
        ((42702, 22), False),
        ((530,), False),
        ((), False),
    ],
)
def test_takeoff_may_follow_items_without_motion(numbers, begins):
    assert starts_with_takeoff([Item(number, MISSION, 0, 0) for number in numbers]) is begins
