"""Landings of the fake copters, timed as observed on ArduCopter 4.7 and PX4 1.17."""

from __future__ import annotations

import pytest
from mavlink_client import ACCEPTED, ARM, FAILED, LAND, MODE, REJECTED, Client
from pymavlink.dialects.v20 import all as dialect

LANDING = {"ardupilot": (9.0,), "px4": (4.0, 6.0)}
RTL = {"ardupilot": (6.0,), "px4": (4.0, 5.0)}


def flying(flavour, height=10.0, **parameters):
    """A client with a hovering copter."""
    c = Client(flavour=flavour, beats=True)
    c.autopilot.parameters.update(parameters)
    if flavour == "px4":
        c.autopilot.parameters["MIS_TAKEOFF_ALT"] = height
        c.heartbeat()
        assert c.command(ARM, 1) == ACCEPTED
        assert c.command(22) == ACCEPTED
        c.wait(15.0)
    else:
        c.up(height)
    assert c.place[2] == pytest.approx(-height, abs=0.3)
    return c


def until(c, happened, bound=120.0):
    """Waits for the event; returns the seconds."""
    start = c.autopilot.now
    while not happened():
        c.wait(0.02)
        assert c.autopilot.now - start < bound
    return c.autopilot.now - start


def landed_state(c):
    return c.ask(245).landed_state


@pytest.mark.few(0)
@pytest.mark.parametrize(
    ("flavour", "sinking", "landed", "disarmed"),
    # ArduCopter: 0.50 m/s, 1.6 s, 0.5 s. PX4: 0.5 to 0.7 m/s, 2.5 to 3 s, COM_DISARM_LAND.
    [("ardupilot", 0.5, 1.6, 0.5), ("px4", 0.61, 2.5, 2.0)],
)
def test_landing_speed_and_disarm_delay_as_observed(flavour, sinking, landed, disarmed):
    c = flying(flavour)
    assert c.command(MODE, 1, *LANDING[flavour]) == ACCEPTED
    c.wait(3.0)
    assert landed_state(c) == dialect.MAV_LANDED_STATE_LANDING
    assert c.autopilot.vehicle.velocity[2] == pytest.approx(sinking, abs=0.01)
    until(c, lambda: not c.autopilot.vehicle.airborne)
    assert landed_state(c) != dialect.MAV_LANDED_STATE_ON_GROUND
    refused = {"ardupilot": FAILED, "px4": REJECTED}[flavour]
    assert c.command(ARM, 0) == refused, "it has not detected the landing yet"
    assert until(c, lambda: c.autopilot.landed) == pytest.approx(landed, abs=0.1)
    assert landed_state(c) == dialect.MAV_LANDED_STATE_ON_GROUND
    assert c.autopilot.armed
    assert until(c, lambda: not c.autopilot.armed) == pytest.approx(disarmed, abs=0.1)
    assert c.autopilot.mode == {"ardupilot": "LAND", "px4": "AUTO.LOITER"}[flavour]
    assert {"ardupilot": "Disarming motors", "px4": "Disarmed by landing\t"}[flavour] in c.texts()


def test_landing_from_ten_metres_takes_the_observed_time():
    c = flying("ardupilot")
    assert c.command(LAND) == ACCEPTED
    assert until(c, lambda: not c.autopilot.armed) == pytest.approx(23.0, abs=1.0)
    c = flying("px4")
    assert c.command(LAND) == ACCEPTED
    assert until(c, lambda: not c.autopilot.armed) == pytest.approx(21.0, abs=1.0), (
        "19.0 to 24.0 s were observed"
    )


def test_return_hovers_over_home_before_it_reports_landing():
    c = flying("ardupilot", 5.0, RTL_ALT=500)
    assert c.command(MODE, 1, *RTL["ardupilot"]) == ACCEPTED
    c.wait(4.5)
    assert landed_state(c) == dialect.MAV_LANDED_STATE_IN_AIR
    assert c.place[2] == pytest.approx(-5.0, abs=0.3)
    c.wait(3.0)
    assert landed_state(c) == dialect.MAV_LANDED_STATE_LANDING
    until(c, lambda: not c.autopilot.armed, 15.0)
