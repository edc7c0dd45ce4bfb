"""Wind on a fake: position hold, drift, battery use, and reported wind."""

from __future__ import annotations

import math

import pytest
from mavlink_client import FAILED, MODE, ONCE, Client

POSITION, VELOCITY = 0x0DF8, 0x0DC7
WIND, WIND_COV, ATTITUDE, HUD = 168, 231, 30, 74
WEST = -math.pi / 2


def hovering(*faults, flavour="ardupilot", height=20.0, system=1):
    """A copter at a height above home, then the faults."""
    client = Client(flavour=flavour, beats=True, system=system)
    if flavour == "px4":
        client.command(400, 1)
        client.command(22, 0, 0, 0, 0, 0, 0, 488.0 + height)
        client.wait(20.0)
    else:
        client.up(height)
    assert client.place[2] == pytest.approx(-height, abs=0.5)
    client.fault(*faults)
    return client


def farthest(client, seconds, place=(0.0, 0.0)):
    """The greatest distance from a place in some seconds."""
    far = 0.0
    for _ in range(round(seconds / 0.1)):
        client.wait(0.1)
        far = max(far, math.dist(client.place[:2], place))
    return far


@pytest.mark.few(1)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_copter_holds_its_position_in_wind(flavour):
    c = hovering("wind=8", flavour=flavour)
    assert 0.01 < farthest(c, 5.0) < 1.0, "it drifts before it tilts"
    c.wait(20.0)
    assert math.dist(c.place[:2], (0.0, 0.0)) < 0.1
    assert c.place[2] == pytest.approx(-20.0, abs=0.5)


def test_copter_tilts_into_the_wind():
    c = hovering("wind=8")
    c.wait(10.0)
    lean = math.atan((8 / 15) ** 2)
    assert c.ask(ATTITUDE).pitch == pytest.approx(-lean, abs=0.02), "its nose, to the north, is down"
    c.fault(f"wind_from={WEST}")
    c.wait(10.0)
    assert c.ask(ATTITUDE).roll == pytest.approx(-lean, abs=0.02), "to the left, to the west"
    c.fault("wind=0")
    c.wait(10.0)
    assert (c.ask(ATTITUDE).roll, c.ask(ATTITUDE).pitch) == pytest.approx((0.0, 0.0), abs=0.01)


@pytest.mark.few(1)
@pytest.mark.parametrize(("flavour", "limit"), [("ardupilot", "ANGLE_MAX"), ("px4", "MPC_TILTMAX_AIR")])
def test_wind_above_the_tilt_limit_carries_the_copter(flavour, limit):
    tilt = {"ANGLE_MAX": math.radians(30), "MPC_TILTMAX_AIR": math.radians(45)}[limit]
    most = 15 * math.sqrt(math.tan(tilt))
    held, drifted = (hovering(f"wind={most + more}", flavour=flavour) for more in (-0.5, 3.0))
    assert farthest(held, 20.0) < 6.0
    assert math.dist(held.place[:2], (0.0, 0.0)) < 0.1
    drifted.wait(20.0)
    assert drifted.place[0] < -20.0, "to the south, as the wind is from the north"
    drift = -drifted.autopilot.vehicle.velocity[0]
    assert drift == pytest.approx(3.0, abs=0.3), "the drift equals the excess of the wind"
    drifted.fault("wind=2")
    drifted.wait(30.0)
    assert math.hypot(*drifted.autopilot.vehicle.velocity[:2]) < 0.05, "it holds again"


def test_lower_tilt_limit_lets_the_copter_drift():
    c = hovering("wind=8")
    c.autopilot.parameters["ANGLE_MAX"] = 1000.0
    c.autopilot.apply_parameters()
    c.wait(20.0)
    assert c.place[0] < -10.0, "10 degrees hold 6.3 m/s"


def test_copter_returns_to_its_position_after_a_storm():
    c = hovering("wind=14")
    assert farthest(c, 10.0) > 10.0
    c.fault("wind=5")
    c.wait(30.0)
    assert math.dist(c.place[:2], (0.0, 0.0)) < 0.3


def test_ground_speed_and_airspeed_in_head_and_tail_wind():
    still, against, behind = hovering(), hovering("wind=8"), hovering("wind=8", f"wind_from={math.pi}")
    for c in (still, against, behind):
        c.target(VELOCITY, velocity=(10, 0, 0))
        c.wait(2.9)
        c.target(VELOCITY, velocity=(10, 0, 0))
        c.wait(2.9)
    speeds = [c.autopilot.vehicle.velocity[0] for c in (still, against, behind)]
    assert speeds[0] == pytest.approx(10.0, abs=0.2)
    assert speeds[1] < 7.0, "its tilt limit does not permit an airspeed of 18 m/s"
    assert speeds[2] == pytest.approx(10.0, abs=0.3)
    hud = against.ask(HUD)
    assert hud.groundspeed == pytest.approx(speeds[1], abs=0.01)
    assert hud.airspeed == pytest.approx(speeds[1] + 8.0, abs=0.01)
    assert behind.ask(HUD).airspeed == pytest.approx(2.0, abs=0.3)


def test_goal_is_reached_later_in_head_wind():
    arrivals = []
    for wind in (0, 8):
        c = hovering(f"wind={wind}")
        c.target(POSITION, place=(60, 0, -20))
        seconds = 0.0
        while math.dist(c.place[:2], (60, 0)) > 0.5 and seconds < 60:
            c.wait(0.1)
            seconds += 0.1
        arrivals.append(seconds)
    assert arrivals[0] + 2.0 < arrivals[1] < 40.0


def test_landing_in_wind_keeps_its_position():
    c = hovering("wind=8", "gusts=3")
    c.wait(5.0)
    c.command(MODE, 1, 9)
    c.wait(60.0)
    assert c.place[2] == 0.0
    assert math.dist(c.place[:2], (0.0, 0.0)) < 0.5


def test_gusts_move_the_copter_slightly():
    c = hovering("wind=4", "gusts=6")
    assert 0.1 < farthest(c, 40.0) < 1.0
    speeds = set()
    for _ in range(200):
        c.wait(0.1)
        speeds.add(round(c.autopilot.vehicle.wind.airspeed((0, 0, 0)), 3))
    assert min(speeds) == 4.0
    assert 6.0 < max(speeds) <= 10.0


def test_gusts_are_reproducible_and_differ_between_vehicles():
    def way(system):
        c = Client(system=system)
        c.fault("wind=4", "gusts=6")
        return [(c.wait(0.5), c.autopilot.vehicle.wind.velocity)[1] for _ in range(60)]

    assert way(1) == way(1)
    assert way(1) != way(2)


def test_hover_in_wind_uses_more_charge():
    def drawn(wind):
        c = hovering(wind)
        before = c.autopilot.battery.charge
        c.wait(60.0)
        return before - c.autopilot.battery.charge

    assert drawn("wind=10") > 1.1 * drawn("wind=0")


def test_tail_wind_needs_less_current_than_head_wind():
    def current(*faults):
        c = hovering(*faults)
        c.target(VELOCITY, velocity=(6, 0, 0))
        c.wait(2.9)
        return c.autopilot.battery.current

    assert current("wind=5", f"wind_from={math.pi}") < current("wind=0") == 18.0 < current("wind=5")


def test_copter_with_motor_failure_drifts_with_the_wind():
    c = hovering("wind=10", "motor_failure=true")
    c.wait(5.0)
    assert c.place[2] == 0.0
    assert c.place[0] < -1.0


def test_attitude_control_drifts_with_the_wind():
    c = hovering("wind=5")
    c.target(0x0C3F, frame=1)
    c.wait(2.0)
    assert c.autopilot.vehicle.velocity[0] < -0.5, "the commanded acceleration is zero"


@pytest.mark.parametrize(("flavour", "kind"), [("ardupilot", "rover"), ("px4", "rover")])
def test_wind_does_not_affect_a_rover(flavour, kind):
    ways = []
    for wind in ("wind=0", "wind=30"):
        c = Client(kind, flavour=flavour, beats=True)
        c.fault(wind, "gusts=10")
        c.command(400, 1)
        c.command_int(192, -1, 1, 0, 0, x=c.fake.place.at(20, 5)[0], y=c.fake.place.at(20, 5)[1], z=488)
        c.wait(10.0)
        ways.append((c.place, c.autopilot.battery.charge, c.autopilot.vehicle.roll))
    assert ways[0] == ways[1]
    assert ways[0][0][0] > 3.0


def test_wind_does_not_move_a_copter_on_the_ground():
    c = Client(beats=True)
    c.fault("wind=30")
    c.command(MODE, 1, 4)
    c.command(400, 1)
    c.wait(5.0)
    assert c.place == (0.0, 0.0, 0.0)


def test_arducopter_reports_the_wind_s_origin():
    c = hovering("wind=6", f"wind_from={WEST}")
    wind = c.ask(WIND)
    assert (wind.direction, wind.speed) == pytest.approx((-90.0, 6.0))
    assert c.command(ONCE, WIND_COV) == FAILED


def test_px4_reports_the_wind_vector_when_it_estimates_wind():
    c = hovering("wind=6", f"wind_from={WEST}", flavour="px4")
    assert not [m for m in c.messages if m.get_msgId() in (WIND, WIND_COV)], "disabled by default"
    c.autopilot.parameters["EKF2_DRAG_CTRL"] = 1.0
    c.wait(1.0)
    reports = [m for m in c.messages if m.get_msgId() == WIND_COV]
    assert len(reports) >= 9, "without a request"
    assert (reports[-1].wind_x, reports[-1].wind_y) == pytest.approx((0.0, 6.0), abs=1e-5)
    assert math.isnan(c.ask(HUD).airspeed)


@pytest.mark.parametrize("text", ["wind=-1", "wind=41", "wind=north", "wind_from=90", "gusts=nan"])
def test_invalid_wind_fault_is_refused(text):
    with pytest.raises(ValueError, match=r"is (from|a number)"):
        Client().fault(text)
