"""Moving targets: speed, lead and end; and the corrected speed command."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield_mavlink.setpoints.speed_correction import SpeedCorrection
from lfield_mavlink.setpoints.trajectory import (
    CLIMB,
    LEAD,
    LEAD_TIME,
    ONLY_POSITION,
    ONLY_VELOCITY,
    POSITION_AND_YAW,
    SINK,
    Leg,
    Pursuit,
    Ring,
    Stay,
)

PERIOD, STILL = 0.05, (0.0, 0.0, 0.0)
metres = st.floats(-200.0, 200.0)
places = st.tuples(metres, metres, st.floats(-60.0, 0.0))
speeds = st.floats(0.2, 15.0)


def follow(trajectory, place, gain=0.95, seconds=600.0, until=None):
    """The targets, and the end position of a vehicle that follows them proportionally."""
    now, targets = 0.0, []
    while now < seconds and not (until is not None and math.dist(place, until) < 0.3):
        target = trajectory.target(now, place, STILL)
        targets.append(target.place)
        place = tuple(p + gain * PERIOD * (t - p) for p, t in zip(place, target.place, strict=True))
        now += PERIOD
    return targets, place


@settings(max_examples=60, deadline=None)
@given(places, places, speeds, st.sampled_from([0.0, 0.3, 0.7, 0.95]))
def test_target_keeps_its_speed_and_lead_limits(place, goal, speed, gain):
    targets, _end = follow(Leg(place, STILL, goal, speed), place, gain, 60.0)
    for one, two in itertools.pairwise(targets):
        assert math.dist(one[:2], two[:2]) <= speed * PERIOD * (1.0 + 1e-6)
        assert -CLIMB * PERIOD * (1.0 + 1e-6) <= two[2] - one[2] <= SINK * PERIOD * (1.0 + 1e-6)
    if gain == 0.0:
        assert math.dist(targets[-1][:2], place[:2]) <= LEAD_TIME * speed + LEAD
        assert abs(targets[-1][2] - place[2]) <= LEAD_TIME * CLIMB + LEAD


@settings(max_examples=40, deadline=None)
@given(places, places, speeds)
def test_follower_arrives_on_the_straight_line(place, goal, speed):
    targets, end = follow(Leg(place, STILL, goal, speed), place, until=goal, seconds=3000.0)
    assert math.dist(end, goal) < 0.3
    way = math.dist(place, goal)
    assert all(math.dist(place, t) + math.dist(t, goal) <= way + 1e-6 for t in targets)


@settings(max_examples=40, deadline=None)
@given(places, st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)), places)
def test_first_target_continues_the_motion_within_the_goal(place, velocity, goal):
    leg = Leg(place, (*velocity, 0.0), goal, 5.0)
    first = leg.target(0.0, place, (*velocity, 0.0)).place
    assert math.dist(place, first) <= min(math.hypot(*velocity) * 1.05, math.dist(place, goal)) + 1e-6


def test_target_waits_without_position_and_after_a_pause():
    leg = Leg(STILL, STILL, (100.0, 0.0, 0.0), 5.0)
    for n in range(40):
        leg.target(n * PERIOD, (0.0, 0.0, 0.0), STILL)
    before = leg.target(2.0, None, STILL).place
    assert leg.target(2.1, None, STILL).place == before
    assert leg.target(60.0, before, STILL).place[0] - before[0] <= 5.0 * 0.2 + 1e-6


def test_new_speed_takes_effect_during_a_leg():
    leg, place = Leg(STILL, STILL, (500.0, 0.0, 0.0), 5.0), STILL
    _, place = follow(leg, place, seconds=10.0)
    leg.speed = 1.0
    targets, _ = follow(leg, place, seconds=30.0)
    assert max(math.dist(a, b) for a, b in itertools.pairwise(targets)) <= PERIOD * 1.0001


def test_turn_target_keeps_the_position_and_sets_the_heading():
    target = Leg(STILL, STILL, STILL, 1.0, yaw=1.2).target(0.0, STILL, STILL)
    assert (target.mask, target.place, target.yaw) == (POSITION_AND_YAW, STILL, 1.2)
    assert Stay((1.0, 2.0, -3.0), 1.0).target(9.0, STILL, STILL).place == (1.0, 2.0, -3.0)
    assert Stay((1.0, 2.0, -3.0), 1.0).target(9.0, STILL, STILL).mask == ONLY_POSITION


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize(("radius", "speed"), [(3.0, 1.0), (6.0, 3.0), (20.0, 5.0)])
def test_ring_is_flown_with_its_radius_within_the_speed(radius, speed, clockwise):
    centre = (5.0, -4.0, -10.0)
    ring = Ring(STILL, STILL, centre, radius, speed, clockwise=clockwise)
    now, place, angles = 0.0, (0.0, 0.0, -10.0), []
    while now < 60.0:
        target = ring.target(now, place, STILL).place
        after = tuple(p + 0.95 * PERIOD * (t - p) for p, t in zip(place, target, strict=True))
        assert math.dist(place[:2], after[:2]) <= speed * PERIOD * 1.001
        place, now = after, now + PERIOD
        if now > 20.0:
            assert math.dist(place[:2], centre[:2]) == pytest.approx(radius, rel=0.05)
            angles.append(math.atan2(place[1] - centre[1], place[0] - centre[0]))
    steps = [math.remainder(b - a, math.tau) for a, b in itertools.pairwise(angles)]
    assert all((step > 0.0) is clockwise for step in steps)


def test_pursuit_slows_down_and_stops_at_the_goal():
    pursuit = Pursuit((10.0, 0.0, 0.0), 2.0, SpeedCorrection())
    far = pursuit.target(0.0, (0.0, 0.0, 0.0), STILL)
    assert (far.mask, far.velocity) == (ONLY_VELOCITY, (2.0, 0.0, 0.0))
    assert pursuit.target(1.0, (9.8, 0.0, 0.0), STILL).velocity[0] == pytest.approx(0.566, abs=0.01)
    assert pursuit.target(2.0, (10.0, 0.0, 0.0), STILL).velocity == STILL
    assert pursuit.target(3.0, None, STILL).velocity == STILL


# -- speed correction -----------------------------------------------------------------------------------


def drive(correction, flown, speed=3.0, seconds=30.0):
    """The final speed of a vehicle that flies `flown(command)`, and the commands."""
    now, commands = 0.0, []
    while now < seconds:
        correction.sample(flown(correction.commanded(speed)), speed, now)
        commands.append(correction.commanded(speed))
        now += 0.1
    return flown(commands[-1]), commands


@settings(max_examples=60, deadline=None)
@given(st.floats(0.75, 1.18), st.floats(0.7, 1.0), st.floats(1.0, 10.0))
def test_overspeed_is_corrected_and_no_command_exceeds_the_speed(gain, share, speed):
    flown, commands = drive(SpeedCorrection(share), lambda commanded: gain * commanded, speed)
    assert max(commands) <= speed * (1.0 + 1e-9)
    assert flown <= speed * 1.02
    assert flown >= 0.95 * min(gain, 1.0) * speed


def test_unrelated_speed_does_not_change_the_correction():
    correction = SpeedCorrection()
    drive(correction, lambda _: 7.0)
    assert correction.share == 1.0
    drive(correction, lambda _: 0.0)
    assert correction.share == 1.0
    correction.share = 0.5
    assert correction.commanded(3.0) == 1.5
    correction.reset()
    assert correction.share == 1.0


def test_correction_is_unchanged_during_acceleration():
    correction = SpeedCorrection(0.85)
    for n in range(40):
        correction.sample(0.1 * n, 3.0, 0.1 * n)
        if n < 29:
            assert correction.commanded(3.0) == pytest.approx(0.85 * 3.0)


@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0])
def test_known_excess_is_compensated_from_the_start(speed):
    correction = SpeedCorrection(excess=0.45)
    flown, commands = drive(correction, lambda commanded: commanded + 0.45, speed)
    assert flown == pytest.approx(speed, rel=0.02)
    assert max(commands) + 0.45 <= 1.15 * speed
    # For another speed the correction is immediate.
    assert correction.commanded(2.0) + 0.45 <= 2.0 * 1.05


def test_proportional_excess_is_corrected():
    flown, _commands = drive(SpeedCorrection(excess=0.45), lambda commanded: 1.5 * commanded, 0.5)
    assert flown == pytest.approx(0.5, rel=0.05)
