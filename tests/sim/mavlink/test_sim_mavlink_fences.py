"""Fence behaviour of the fakes, as in the traces f-fence-landing and f-fence-breach."""

from __future__ import annotations

import math

import pytest
from mavlink_client import ACCEPTED, ARM, FAILED, GUIDED, MODE, TAKEOFF, Client
from pymavlink.dialects.v20 import all as dialect

NAN = math.nan
PLACE, VELOCITY = 0x0DF8, 0x0DC7
FENCE = {"FENCE_ENABLE": 1, "FENCE_RADIUS": 30}


def copter(**parameters):
    c = Client()
    c.autopilot.parameters.update({**FENCE, **parameters})
    c.up(10.0)
    return c


def rover(**parameters):
    c = Client("rover")
    c.autopilot.parameters.update({**FENCE, **parameters})
    c.command(MODE, 1, 15)
    c.command(ARM, 1)
    return c


def reposition(c, north):
    lat, lon = c.fake.place.at(north, 0.0)
    return c.command_int(192, -1, 1, 0, NAN, x=lat, y=lon, z=10.0, frame=6)


def drive(c, speed, seconds):
    """Sends a northward velocity each second."""
    for _ in range(seconds):
        c.target(VELOCITY, velocity=(speed, 0, 0))
        c.wait(1.0)


def test_arducopter_ignores_a_goal_beyond_its_fence():
    c = copter()
    c.target(PLACE, (60, 0, -10))
    c.wait(3.0)
    assert c.place[0] == pytest.approx(0.0, abs=0.1)
    assert reposition(c, 60.0) == FAILED
    c.wait(1.0)
    assert c.place[0] == pytest.approx(0.0, abs=0.1)
    assert c.texts() == ["Arming motors"], "no message about the fence"


@pytest.mark.parametrize("make", [copter, rover])
def test_ardupilot_velocity_stops_before_the_fence(make):
    c = make()
    drive(c, 4, 20)
    assert 26.0 < c.place[0] < 29.0, "FENCE_MARGIN before the edge"
    assert not c.ask(162).breach_status
    assert c.autopilot.mode == "GUIDED"


def test_rover_drives_up_to_the_fence_for_a_goal_beyond():
    c = rover()
    assert reposition(c, 60.0) == ACCEPTED
    c.wait(30.0)
    assert 26.0 < c.place[0] < 29.0


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("make", "action", "mode", "texts"),
    [
        (copter, 1, "RTL", {"Circle fence breached", "Manual recovery started"}),
        (copter, 2, "LAND", {"Circle fence breached", "Manual recovery started"}),
        (copter, 4, "BRAKE", {"Circle fence breached", "Manual recovery started"}),
        (rover, 2, "HOLD", {"Manual recovery started"}),
    ],
)
def test_breach_without_avoidance_triggers_the_fence_action(make, action, mode, texts):
    c = make(AVOID_ENABLE=0, FENCE_ACTION=action)
    c.wait(0.1)
    c.messages.clear()
    while c.place[0] < 30.0:
        drive(c, 4, 1)
    c.wait(0.3)
    assert c.autopilot.mode == mode
    assert set(c.texts()) == texts
    status = c.ask(162)
    assert (status.breach_status, status.breach_type, status.breach_count) == (1, 3, 1)
    assert not c.autopilot.critical, "its heartbeats do not show it"
    c.messages.clear()
    guided = GUIDED if make is copter else 15
    assert c.command(MODE, 1, guided) == ACCEPTED, "also outside"
    c.target(PLACE, (0, 0, -10))
    c.wait(20.0)
    cleared = ["Fence breach cleared"] if make is copter else []
    assert c.texts() == ["Manual recovery started", *cleared]
    assert not c.ask(162).breach_status


def px4():
    c = Client(flavour="px4", beats=True)
    c.autopilot.parameters.update({"GF_MAX_HOR_DIST": 30, "GF_ACTION": 3, "MIS_TAKEOFF_ALT": 10})
    c.heartbeat()
    c.command(ARM, 1)
    c.command(TAKEOFF, *[NAN] * 7)
    c.wait(15.0)
    return c


def test_px4_accepts_a_goal_beyond_its_fence_and_refuses_by_text():
    c = px4()
    lat, lon = c.fake.place.at(60.0, 0.0)
    assert c.command_int(192, -1, 1, 0, NAN, x=lat, y=lon, z=c.fake.place.altitude + 10) == ACCEPTED
    c.wait(2.0)
    assert c.place[0] == pytest.approx(0.0, abs=0.1)
    assert "Reposition is outside geofence\t" in c.texts()


def test_px4_crosses_its_fence_holds_and_then_acts():
    c = px4()
    for number in range(130):
        c.target(VELOCITY, velocity=(4, 0, 0))
        c.wait(0.1)
        if number == 5:
            c.command(MODE, 1, 6)
    assert c.autopilot.mode == "AUTO.LOITER"
    assert [m.system_status for m in c.messages if m.get_type() == "HEARTBEAT"][-1] == 5
    assert {
        "Geofence: exceeding maximum distance to Home",
        "Failsafe activated: entering Hold for 5 seconds\t",
    } <= set(c.texts())
    c.wait(5.0)
    assert c.autopilot.mode == "AUTO.RTL"


def states(c, seconds):
    """The reported landed states, without repetitions, in order."""
    c.command(511, 245, 100_000)
    reported = [m.landed_state for m in c.wait(seconds) if m.get_type() == "EXTENDED_SYS_STATE"]
    return [state for state, before in zip(reported, [None, *reported], strict=False) if state != before]


@pytest.mark.few(0)
def test_landed_states_of_a_flight():
    c = Client()
    c.command(MODE, 1, GUIDED)
    c.command(ARM, 1)
    c.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10)
    c.wait(2.9)
    assert c.ask(245).landed_state == dialect.MAV_LANDED_STATE_ON_GROUND, "the motors spin up first"
    assert states(c, 12.0) == [1, 3, 2]
    c.command(21)
    assert states(c, 25.0) == [4, 1]
    c = Client(flavour="px4", beats=True)
    c.autopilot.parameters["MIS_TAKEOFF_ALT"] = 10
    c.heartbeat()
    c.command(ARM, 1)
    c.command(TAKEOFF, *[NAN] * 7)
    assert states(c, 12.5) == [1, 3, 2]
    assert {"Using default takeoff altitude: 10.0 m\t", "Takeoff detected\t"} <= set(c.texts())
    c.command(21)
    assert states(c, 25.0) == [4, 1]
    assert c.autopilot.mode == "AUTO.LOITER"


def test_loiter_without_a_transmitter_sinks_to_the_ground():
    c = Client()
    c.up(10.0)
    assert c.command(MODE, 1, 5) == ACCEPTED
    c.wait(3.0)
    assert c.autopilot.vehicle.velocity[2] == pytest.approx(2.5, abs=0.1)
    c.wait(4.0)
    assert c.place[2] == 0.0
