"""Targets of another station: velocities and heights, at any time of a flight; and false alarms."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise

import pytest
from coroutine_tests import on_bench
from test_mavlink_flight_faults import at, fails, foreign, reposition, setpoint, up

from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.link.ports import Neighbours
from lfield_mavlink.monitors.target_monitor import FIRST_TARGET_TIMEOUT, LATE, CourseMonitor, TargetMonitor

HOME, GOAL, ELSEWHERE = (0.0, 0.0, -8.0), (60.0, 0.0, -8.0), (-20.0, -20.0, -8.0)


def velocity(north, east, down, target=1):
    fields = (0.0, 0.0, 0.0, north, east, down, *[0.0] * 5)
    return dialect.MAVLink_set_position_target_local_ned_message(0, target, 1, 1, 0x0DC7, *fields)


def interfered(b, message, *, after, pause=0.2, known=True):
    """A station sends a message repeatedly; returns the start on the loop's clock, and the task."""
    begins = asyncio.get_running_loop().time() + after

    async def interfere():
        await asyncio.sleep(after)
        while True:
            data = foreign(b, message)
            if known:
                b.links[0].on_data(data)
            await asyncio.sleep(pause)

    return begins, asyncio.create_task(interfere())


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("flavour", "kind", "sent", "words"),
    [
        ("ardupilot", "copter", (0.0, 0.0, 1.0), "another station has sent it elsewhere, at 1.0 m/s"),
        ("px4", "copter", (-2.0, -2.0, 0.0), "another station has sent it elsewhere, at 2.8 m/s"),
        ("ardupilot", "rover", (-1.0, -1.0, 0.0), "another station has sent it elsewhere, to no place"),
        ("ardupilot", "rover", (1.5, 0.5, 0.0), "another station has sent it elsewhere, to no place"),
        ("ardupilot", "rover", (0.0, 0.0, 0.0), "another station has sent it elsewhere, to no place"),
        ("ardupilot", "copter", (2.0, 1.0, 0.0), "another station has sent it elsewhere, at 2.2 m/s"),
        ("ardupilot", "copter", (0.0, 0.0, 0.0), "another station has sent it elsewhere, at 0.0 m/s"),
        ("px4", "rover", (-1.0, -1.0, 0.0), "m from its goal it moves elsewhere, at 1."),
    ],
)
@on_bench("bench", limits={"speed": 3.0}, given="flavour kind")
async def test_foreign_velocities_are_a_takeover_within_two_seconds(b, fc, /, flavour, kind, sent, words):
    if kind == "copter":
        await up(fc)
    else:
        await fc.execute("arm", [])
    pause = 0.03 if flavour == "px4" else 0.2
    started, other = interfered(b, velocity(*sent), after=6.25, pause=pause)
    ended, reason = await fails(b, fc.execute("goTo", list(GOAL)))
    assert ended - started < 2.0
    assert words in reason
    assert "system 77, component 190" in reason
    assert fc.taken_over()
    other.cancel()


@pytest.mark.parametrize("message", [setpoint(*ELSEWHERE), velocity(-2.0, 0.0, 0.0)])
@on_bench("bench", limits={"speed": 3.0}, ttl=1.0)
async def test_takeover_ends_a_flight_by_velocities(b, fc, /, message):
    await up(fc)
    started, other = interfered(b, message, after=3.03, pause=0.1)

    async def flight():
        while True:
            await fc.execute("setVelocity", [1.0, 0.0, 0.0])
            await asyncio.sleep(0.2)

    ended, reason = await fails(b, flight())
    assert 0.0 < ended - started < 2.0
    assert "setVelocity refused: another station has sent it elsewhere" in reason
    other.cancel()


@on_bench("bench")
async def test_takeover_in_takeoff_or_hover_is_detected(b, fc, /):
    await fc.execute("arm", [])
    started = at(4.0, lambda: foreign(b, setpoint(*ELSEWHERE)))
    ended, reason = await fails(b, fc.execute("takeoff", [20.0]))
    assert ended - started < 2.0
    assert "takeoff ended early: another station has sent it elsewhere, to a place 28 m away" in reason
    await fc.execute("release", [])
    await fc.execute("hold", [])
    await asyncio.sleep(4.0)
    assert not fc.taken_over()
    foreign(b, reposition(b, 30.0, 30.0, 8.0))
    await asyncio.sleep(2.0)
    assert fc.taken_over()


@on_bench("bench")
async def test_foreign_height_is_a_takeover_although_a_router_echoes(b, fc, /):
    await up(fc)
    send = b.links[0].send
    b.links[0].send = lambda data: (send(data), b.links[0].on_data(data))
    started = at(6.25, lambda: foreign(b, setpoint(60.0, 0.0, -15.0)))
    ended, reason = await fails(b, fc.execute("goTo", list(GOAL)))
    assert ended - started < 2.0
    assert "sent it elsewhere, 7 m from its goal;" in reason, (
        "no message of the other station was received here"
    )


@on_bench("bench", flavour="px4", kind="rover", limits={"speed": 3.0})
async def test_foreign_reposition_of_a_px4_rover_is_a_takeover(b, fc, /):
    await fc.execute("arm", [])
    at(6.25, lambda: b.links[0].on_data(foreign(b, reposition(b, -20.0, -20.0, 0.0))))
    _, reason = await fails(b, fc.execute("goTo", list(GOAL)))
    assert "went to AUTO.LOITER, commanded by system 77, component 190" in reason
    assert fc.taken_over()


# -- pure ---------------------------------------------------------------------------------------------


def test_goal_before_a_lost_goal_is_still_an_own_target():
    """ArduPilot receives its own position, then its goal; on a bad radio the goal is late."""
    monitor = TargetMonitor()
    monitor.clear(0.0)
    monitor.on_place(HOME, 0.0, HOME)
    monitor.on_reported_place(HOME, 1.0, HOME, aloft=True)
    for second in range(1, 8):
        monitor.on_place(GOAL, float(second), None)
        monitor.on_reported_place(HOME, second + 0.5, HOME, aloft=True)
    assert monitor.on_guided(9.0) == ""
    monitor.on_reported_place(ELSEWHERE, 9.0, HOME, aloft=True)
    assert monitor.on_guided(9.5) == "82 m from its goal"


@pytest.mark.parametrize(
    ("reported", "is_foreign"),
    [
        ((60.02, 0.0, -8.0), False),
        ((60.0, 0.0, -8.3), False),
        ((60.0, 0.8, -8.0), True),
        ((60.0, 0.0, -9.5), True),
        ((60.0, 0.0, math.nan), False),
    ],
)
def test_reported_target_is_own_within_a_tolerance(reported, is_foreign):
    monitor = TargetMonitor()
    monitor.clear(0.0)
    monitor.on_place(GOAL, 0.0, HOME)
    monitor.on_reported_place((1.5, 1.0, -6.0), 0.5, HOME, aloft=True)
    monitor.on_reported_place(GOAL, 1.0, HOME, aloft=True)
    monitor.on_reported_place(reported, 3.0, HOME, aloft=True)
    assert bool(monitor.on_guided(4.0)) == is_foreign


def test_targets_of_the_last_motion_are_own_for_a_limited_time():
    monitor = TargetMonitor()
    for at_, place in enumerate((HOME, GOAL)):
        monitor.on_place(place, float(at_), None)
    monitor.clear(2.0)
    monitor.on_place(ELSEWHERE, 2.0, GOAL)
    monitor.on_reported_place(ELSEWHERE, 2.2, GOAL, aloft=True)
    monitor.on_reported_place(HOME, 2.0 + LATE - 0.1, GOAL, aloft=True)
    assert monitor.on_guided(9.0) == ""
    monitor.on_reported_place(HOME, 2.0 + LATE + 0.1, GOAL, aloft=True)
    assert monitor.on_guided(9.0) != ""


def test_earlier_foreign_stream_is_found_after_the_first_timeout():
    monitor = TargetMonitor()
    monitor.clear(0.0)
    monitor.on_place(GOAL, 0.0, HOME)
    monitor.on_reported_place(ELSEWHERE, FIRST_TARGET_TIMEOUT - 0.1, HOME, aloft=True)
    assert monitor.on_guided(2.0) == ""
    monitor.on_reported_place(ELSEWHERE, FIRST_TARGET_TIMEOUT + 0.1, HOME, aloft=True)
    assert monitor.on_guided(2.0) != ""


@pytest.mark.parametrize(
    ("sent", "reported", "is_foreign"),
    [
        ((2.0, 0.0, 0.0), (2.0, 0.0, 0.0), False),
        ((2.0, 0.0, 0.0), (1.2, 0.0, 0.0), False),  # bounded by its own limit
        ((2.0, 0.0, -1.0), (2.0, 0.0, -0.4), False),  # it climbs more slowly
        ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),  # its time is over
        ((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), True),
        ((2.0, 0.0, 0.0), (2.0, 1.0, 0.0), True),
        ((2.0, 0.0, 0.0), (4.0, 0.0, 0.0), True),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), True),
    ],
)
def test_reported_velocity_is_own_if_equal_or_limited(sent, reported, is_foreign):
    monitor = TargetMonitor()
    monitor.on_velocity(sent, 0.0)
    monitor.on_reported_velocity(reported, 0.2)
    assert bool(monitor.on_guided(1.0)) == is_foreign


def reported_distances(*reported, here=HOME, received=True, goal=GOAL):
    """The finding when a rover reports these distances, five per second, on its way to a goal."""
    monitor = TargetMonitor(level=False)
    monitor.clear(0.0)
    monitor.on_place(goal, 0.0, HOME)
    if received:
        monitor.on_reported_place(goal, 0.5, HOME, aloft=False)
    for number, distance in enumerate(reported):
        monitor.on_reported_distance(distance, here, 2.0, 1.0 + number / 5)
    return monitor.on_guided(9.0)


def test_rover_that_reports_distance_0_far_from_its_goal_is_foreign():
    """NAV_CONTROLLER_OUTPUT of ap-rover.f-fence-landing: 34, 33, 33, then 0 while it follows velocities."""
    assert reported_distances(59, 59, 0, 0) == "to no place, 60 m before its goal"
    assert reported_distances(59, 0, 59, 0) != "", "the own goal is sent again in between"
    assert reported_distances(59, 0, *[59] * 20, 0) == "", "these are too far apart"
    assert reported_distances(59, 59, 58, 57) == ""
    assert reported_distances(0, 0, 0, received=False) == "", "it has not accepted the goal yet"
    assert reported_distances(2, 0, 0, here=(58.0, 0.0, 0.0)) == "", "it arrives"
    assert reported_distances(0, 0, here=None) == ""


def test_arrived_rover_with_a_pending_goal_is_not_foreign():
    monitor = TargetMonitor(level=False)
    monitor.clear(0.0)
    monitor.on_place(HOME, 0.0, HOME)
    monitor.on_reported_place(HOME, 0.2, HOME, aloft=False)
    monitor.on_place(GOAL, 3.0, HOME)
    for at_ in (3.2, 3.4, 3.6):
        monitor.on_reported_distance(0, HOME, 0.0, at_)
    assert monitor.on_guided(9.0) == ""
    monitor.on_reported_place(GOAL, 4.0, HOME, aloft=False)
    for at_ in (4.1, 4.3):
        monitor.on_reported_distance(0, HOME, 0.0, at_)
    assert monitor.on_guided(9.0) == "to no place, 60 m before its goal"


def test_same_goal_of_an_earlier_motion_needs_a_new_report():
    monitor = TargetMonitor(level=False)
    monitor.clear(0.0)
    monitor.on_place(GOAL, 0.0, HOME)
    monitor.on_velocity((1.0, 0.0, 0.0), 1.0)
    for at_ in (1.1, 1.3):
        monitor.on_reported_distance(0, HOME, 2.0, at_)
    monitor.on_place(GOAL, 1.5, HOME)
    monitor.on_reported_place(GOAL, 1.6, HOME, aloft=False)
    for at_ in (1.7, 1.9, 2.1):
        monitor.on_reported_distance(0, HOME, 2.0, at_)
    assert monitor.on_guided(9.0) == ""
    for at_ in (5.7, 5.9):
        monitor.on_reported_distance(0, HOME, 2.0, at_)
    assert monitor.on_guided(9.0) != ""


def test_old_target_on_the_ground_is_ignored():
    monitor = TargetMonitor()
    monitor.clear(0.0)
    monitor.on_reported_place(GOAL, 50.0, HOME, aloft=False)
    assert monitor.on_guided(60.0) == ""


def course(*velocities, start=(0.0, 0.0, 0.0), step=0.1):
    """For each velocity, held for a second: whether the vehicle leaves its course to GOAL."""
    monitor, place, now = CourseMonitor(), start, 0.0
    monitor.start(GOAL)
    left = []
    for north, east in velocities:
        for _ in range(10):
            now, place = now + step, (place[0] + north * step, place[1] + east * step, -8.0)
            monitor.on_motion(place, (north, east, 0.0), now)
        left.append(monitor.leaves > 0.0)
    return left


def test_leaving_the_course_is_found_only_after_following_it():
    assert course((2.0, 0.0), (0.0, 2.0)) == [False, True]
    assert course((2.0, 0.0), (-2.0, 0.0), (2.0, 0.0)) == [False, True, False]
    assert course((2.0, 0.5), (2.0, -1.0)) == [False, False], "it swerves"
    assert course((-2.0, 0.0), (0.0, 2.0), (2.0, 1.0)) == [False] * 3, "a rover turns first"
    assert course((2.0, 0.0), (0.0, 0.5)) == [False, False], "wind moves a standing vehicle"
    assert course((2.0, 0.0), (-2.0, 0.0), start=(58.0, 0.0, 0.0)) == [False, False], "it is there"


def test_sender_of_a_motion_command_is_named():
    mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)

    def commander(message, target):
        message.pack(mav)
        neighbours = Neighbours()
        neighbours.on_command(message, 1.0)
        return neighbours.commander(target, 2.0)

    def command(number, target=1):
        return dialect.MAVLink_command_long_message(target, 1, number, 0, *[0.0] * 7)

    assert commander(velocity(1.0, 0.0, 0.0), 1) == "system 255, component 190"
    assert commander(velocity(1.0, 0.0, 0.0, target=0), 1) == "system 255, component 190"
    assert commander(command(dialect.MAV_CMD_DO_REPOSITION), 1) == "system 255, component 190"
    assert commander(command(dialect.MAV_CMD_DO_REPOSITION, target=2), 1) == ""
    assert commander(command(dialect.MAV_CMD_REQUEST_MESSAGE), 1) == "", "QGroundControl sends many requests"


def test_own_successive_velocities_are_not_foreign():
    monitor = TargetMonitor()
    sent = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, -0.5), (0.0, 0.0, 0.0)]
    for number, (before, now) in enumerate(pairwise(sent)):
        at_ = 0.2 * number
        monitor.on_velocity(now, at_)
        monitor.on_reported_velocity(now, at_ + 0.1)
        if number:
            monitor.on_reported_velocity(before, at_ + 0.15)
    assert monitor.on_guided(9.0) == ""
