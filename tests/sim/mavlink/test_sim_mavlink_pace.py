"""Kept and discarded speed commands of the fakes, as in the c-speed traces of three autopilots."""

from __future__ import annotations

import math

import pytest
from mavlink_client import ACCEPTED, ARM, DENIED, FAILED, GUIDED, MODE, SPEED, TAKEOFF, Client

NAN = math.nan
PLACE, BOTH, VELOCITY = 0x0DF8, 0x0DC0, 0x0DC7


def top(c, seconds=8.0):
    """The highest speed over ground in the next seconds."""
    found = 0.0
    for _ in range(round(seconds / 0.1)):
        c.wait(0.1)
        found = max(found, math.hypot(*c.autopilot.vehicle.velocity[:2]))
    return found


@pytest.fixture
def copter():
    c = Client()
    c.up(10.0)
    c.wait(4.0)
    return c


def set_speed(c, speed):
    return c.command(SPEED, 1, speed, -1)


def go(c, north, mask=PLACE, velocity=(0, 0, 0)):
    c.target(mask, (north, 0, -10), velocity)


def test_speed_set_before_the_first_goal_is_lost(copter):
    assert set_speed(copter, 3) == ACCEPTED
    go(copter, 60)
    assert top(copter) > 6.0


def test_speed_set_during_a_goal_is_kept_until_position_control_ends(copter):
    go(copter, 60)
    copter.wait(0.2)
    assert set_speed(copter, 3) == ACCEPTED
    assert top(copter) == pytest.approx(3.0, abs=0.1)
    go(copter, -60)
    assert top(copter) == pytest.approx(3.0, abs=0.1), "the next goal keeps it"
    copter.target(VELOCITY, velocity=(0, 1, 0))
    copter.wait(1.0)
    go(copter, 60)
    assert top(copter) > 6.0, "a velocity in between has ended it"


def test_goal_at_the_current_position_starts_position_control(copter):
    go(copter, copter.place[0])
    copter.wait(0.3)
    set_speed(copter, 3)
    go(copter, 60)
    assert top(copter) == pytest.approx(3.0, abs=0.1)


def test_goal_with_a_velocity_is_flown_at_full_speed(copter):
    go(copter, copter.place[0])
    set_speed(copter, 3)
    go(copter, 60, BOTH, (3, 0, 0))
    assert top(copter) > 8.0


def test_speed_of_a_reposition_is_ignored_by_arducopter(copter):
    lat, lon = copter.fake.place.at(60.0, 0.0)
    assert copter.command_int(192, 3, 1, 0, NAN, x=lat, y=lon, z=10.0, frame=6) == ACCEPTED
    assert top(copter) > 8.0


def test_speed_parameter_takes_effect_at_the_next_start(copter):
    go(copter, 60)
    copter.autopilot.parameters["WPNAV_SPEED"] = 300
    copter.autopilot.apply_parameters()
    assert top(copter, 4.0) > 6.0
    copter.target(VELOCITY, velocity=(6, 0, 0))
    copter.wait(2.5)
    assert top(copter, 0.4) == pytest.approx(6.0, abs=0.1), "a velocity is not limited"
    go(copter, -60)
    copter.wait(6.0)
    assert top(copter) == pytest.approx(3.0, abs=0.1)


def test_rover_accepts_a_speed_only_during_a_goal():
    c = Client("rover")
    c.command(MODE, 1, 15)
    c.command(ARM, 1)
    assert set_speed(c, 2) == FAILED
    lat, lon = c.fake.place.at(60.0, 0.0)
    assert c.command_int(192, 2, 1, 0, NAN, x=lat, y=lon, z=0.0, frame=6) == FAILED
    assert top(c, 3.0) == 0.0
    c.target(PLACE, (80, 0, 0))
    assert set_speed(c, 2) == ACCEPTED
    assert top(c) == pytest.approx(2.2, abs=0.05), "it overshoots"
    c.target(PLACE, (120, 0, 0))
    assert top(c) == pytest.approx(2.0, abs=0.1)
    c.command(MODE, 1, 4)
    c.command(MODE, 1, 15)
    assert set_speed(c, 2) == FAILED, "GUIDED was entered again"
    c.target(PLACE, (160, 0, 0))
    c.autopilot.parameters["WP_SPEED"] = 1.5
    assert top(c) == pytest.approx(2.0, abs=0.1), "it was still coasting"
    assert c.autopilot.vehicle.velocity[0] == pytest.approx(1.5, abs=0.1)


@pytest.fixture
def px4():
    c = Client(flavour="px4", beats=True)
    c.autopilot.parameters["MIS_TAKEOFF_ALT"] = 10
    c.heartbeat()
    c.command(ARM, 1)
    c.command(TAKEOFF, *[NAN] * 7)
    c.wait(15.0)
    return c


def reposition(c, north, speed=-1.0):
    lat, lon = c.fake.place.at(north, 0.0)
    assert c.command_int(192, speed, 1, 0, NAN, x=lat, y=lon, z=c.fake.place.altitude + 10) == ACCEPTED


@pytest.mark.few(0)
def test_px4_uses_the_speed_of_a_goal_for_this_goal_only(px4):
    reposition(px4, 80, 3)
    assert top(px4, 9.1) == pytest.approx(2.66, abs=0.1), "it reaches a speed within 20 s"
    reposition(px4, -80)
    assert top(px4, 9.1) == pytest.approx(4.25, abs=0.15)


@pytest.mark.few(0)
def test_px4_keeps_a_set_speed_until_it_is_reset(px4):
    reposition(px4, 80)
    assert set_speed(px4, 2) == ACCEPTED
    assert top(px4, 5.0) < 2.0
    reposition(px4, -80)
    assert top(px4) < 2.0
    assert set_speed(px4, -1) == ACCEPTED
    reposition(px4, 80)
    assert top(px4, 9.1) == pytest.approx(4.25, abs=0.25)


def test_px4_accelerates_as_recorded(px4):
    """Seconds and m/s over ground of a DO_REPOSITION with 3 m/s (px4-copter.deaths-6)."""
    reposition(px4, 400, 3)
    passed = 0.0
    for seconds, speed in ((6.3, 2.38), (8.7, 2.61), (10.7, 2.73), (14.7, 2.86), (25.0, 2.95)):
        px4.wait(seconds - passed)
        passed = seconds
        assert px4.autopilot.vehicle.velocity[0] == pytest.approx(speed, abs=0.25)


def test_px4_does_not_exceed_its_maximum_speed(px4):
    px4.autopilot.parameters["MPC_XY_VEL_MAX"] = 3.0
    px4.autopilot.apply_parameters()
    reposition(px4, 80, 6)
    assert top(px4) == pytest.approx(2.6, abs=0.1)


def test_zero_or_negative_speed_is_denied(copter):
    assert set_speed(copter, 0) == DENIED
    assert set_speed(copter, -5) == DENIED
    assert copter.command(MODE, 1, GUIDED) == ACCEPTED
