"""The guard of a flying vehicle, in virtual time: expired setpoints, the end, and guard restarts."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import scenario
from pymavlink import mavutil
from test_guard_process import BRISK, binding

from lfield.driver import DeviceError
from lfield.testing.desk import Desk

AGAIN = "its guard died and was restarted"


@pytest.fixture
def desk():
    return Desk()


@pytest.fixture
def fly(desk):
    """Runs `story(flight)` with a vehicle behind its guard: `fly(story, safe_state="hold")`."""

    def run(story, **changes):
        state = changes.get("safe_state", "land")
        fake = desk.fake("mavlink", "--listen", "udp:127.0.0.1:0", "--set-up", state, *BRISK)
        return desk.run(story, binding(fake.endpoint, **changes))

    return run


async def up(flight, height=5.0):
    await flight.call("arm")
    await flight.call("takeoff", height)


async def mode_is(flight, mode):
    await flight.reads("mode", lambda now: now == mode)


@scenario("fly", ttl=1.0, safe_state="hold")
async def test_expired_setpoint_latches_the_safe_state(flight, /):
    await up(flight, 3.0)
    await flight.call("setVelocity", 2.0, 0.0, 0.0)
    await flight.until_note("in safe state 'hold': the setpoint has expired (time-to-live 1 s)")
    with pytest.raises(DeviceError, match=r"call release\(\) first"):
        await flight.call("goTo", 0.0, 0.0, -3.0)
    assert flight.latched
    await flight.call("release")
    await flight.call("goTo", 0.0, 0.0, -3.0)


def test_closing_the_host_lands_a_flying_vehicle(desk, fly):
    flights = []

    async def story(flight):
        flights.append(flight)
        await up(flight, 3.0)

    fly(story)
    (flight,) = flights
    assert "alpha.fc in safe state 'land': the host is stopping" in flight.notes

    async def look(again):
        await again.reads("armed", lambda now: now is False)

    desk.run(look, flight.binding)


# --- control after a guard restart: the program's, unless another controller is known ------


async def by_a_pilot(flight, mode):
    """A pilot changes the mode over a separate link."""
    _, host, port = flight.binding.endpoint.split(":")
    _, link = await asyncio.open_connection(host, int(port))
    numbers = {name: number for number, name in mavutil.mode_mapping_acm.items()}
    pilot = mavutil.mavlink.MAVLink(link, srcSystem=77)
    pilot.set_mode_send(1, mavutil.mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, numbers[mode])
    link.close()


async def in_a_mission(flight):
    """Starts a mission with a long leg, in AUTO."""
    north, east, _ = await flight.call("globalPosition")
    await flight.call("uploadMission", [north + 0.01, east, 5.0])
    flight.leg = asyncio.ensure_future(flight.call("startMission"))
    flight.leg.add_done_callback(lambda leg: leg.exception())
    await mode_is(flight, "AUTO")


async def in_a_circle(flight):
    await flight.call("setMode", "CIRCLE")


@pytest.mark.parametrize("enter_mode", [in_a_mission, in_a_circle])
@scenario("fly")
async def test_guard_restart_lands_the_program_s_flight_in_any_mode(flight, /, desk, enter_mode):
    await up(flight)
    await enter_mode(flight)
    # Twice: the second guard has no more information than the first.
    for _ in range(2):
        dead = flight.guard_pid
        desk.kill(dead)
        await flight.until(lambda dead=dead: flight.guard_pid not in (0, dead), 20.0, "the next guard")
    await flight.until_note(f"in safe state 'land': {AGAIN}")
    await mode_is(flight, "LAND")
    await flight.reads("armed", lambda now: now is False)
    assert not any("not commanded: the vehicle is in" in note for note in flight.notes)


@pytest.mark.parametrize("times", [1, 2])
@scenario("fly", rest_within=2.0)
async def test_guard_restart_leaves_a_pilot_in_control(flight, /, desk, times):
    # In LOITER without a transmitter a copter sinks at 2.5 m/s; it must not reach the ground.
    await up(flight, 40.0)
    await by_a_pilot(flight, "LOITER")
    await mode_is(flight, "LOITER")
    for already in range(times):
        desk.kill(flight.guard_pid)
        # Each guard must work before it is killed: after 2 s without heartbeats the autopilot's own
        # failsafe lands.
        await flight.until(
            lambda already=already: sum("not commanded: " in note for note in flight.notes) > already,
            20.0,
            "the next guard",
        )
        await asyncio.sleep(2.0)
    by_a_pilot_still = "flown by a pilot in LOITER, "
    await flight.until(lambda: (flight.moving or "").startswith(by_a_pilot_still), 20.0, "who flies it")
    await asyncio.sleep(3.0)
    assert flight.query("mode") == "LOITER"
    assert any("not commanded: the vehicle is in" in note for note in flight.notes)


@scenario("fly")
async def test_guard_restart_lands_a_flight_returned_to_the_program(flight, /, desk):
    await up(flight)
    await by_a_pilot(flight, "LOITER")
    await mode_is(flight, "LOITER")
    await flight.call("release")
    desk.kill(flight.guard_pid)
    await flight.until_note(f"in safe state 'land': {AGAIN}")
    await mode_is(flight, "LAND")
