"""The guard of a flying vehicle, in virtual time: expired setpoints, end of the host, guard restarts."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import scenario
from pymavlink import mavutil
from test_guard_process import BRISK, binding

from lfield.driver import DeviceError
from lfield.testing.desk import Desk

RESTART_REASON = "its guard died and was restarted"


@pytest.fixture
def desk():
    return Desk()


@pytest.fixture
def fly(desk):
    """Runs `steps(flight)` with a vehicle behind its guard: `fly(steps, safe_state="hold")`."""

    def run(steps, **changes):
        state = changes.get("safe_state", "land")
        fake = desk.fake("mavlink", "--listen", "udp:127.0.0.1:0", "--set-up", state, *BRISK)
        return desk.run(steps, binding(fake.endpoint, **changes))

    return run


async def take_off(flight, height=5.0):
    await flight.call("arm")
    await flight.call("takeoff", height)


async def wait_for_mode(flight, mode):
    await flight.reads("mode", lambda now: now == mode)


@scenario("fly", ttl=1.0, safe_state="hold")
async def test_expired_setpoint_latches_the_safe_state(flight, /):
    await take_off(flight, 3.0)
    await flight.call("setVelocity", 2.0, 0.0, 0.0)
    await flight.until_note("in safe state 'hold': the setpoint has expired (time-to-live 1 s)")
    with pytest.raises(DeviceError, match=r"call release\(\) first"):
        await flight.call("goTo", 0.0, 0.0, -3.0)
    assert flight.latched
    await flight.call("release")
    await flight.call("goTo", 0.0, 0.0, -3.0)


def test_closing_the_host_lands_a_flying_vehicle(desk, fly):
    flights = []

    async def steps(flight):
        flights.append(flight)
        await take_off(flight, 3.0)

    fly(steps)
    (flight,) = flights
    assert "alpha.fc in safe state 'land': the host is stopping" in flight.notes

    async def wait_until_disarmed(flight_after_restart):
        await flight_after_restart.reads("armed", lambda now: now is False)

    desk.run(wait_until_disarmed, flight.binding)


# --- a guard restart: the program keeps control, unless a pilot is known to control the vehicle ------


async def change_mode_as_pilot(flight, mode):
    """A pilot changes the mode over a separate link."""
    _, host, port = flight.binding.endpoint.split(":")
    _, link = await asyncio.open_connection(host, int(port))
    numbers = {name: number for number, name in mavutil.mode_mapping_acm.items()}
    pilot = mavutil.mavlink.MAVLink(link, srcSystem=77)
    pilot.set_mode_send(1, mavutil.mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, numbers[mode])
    link.close()


async def start_long_mission(flight):
    """Starts a mission with a long leg, in AUTO."""
    north, east, _ = await flight.call("globalPosition")
    await flight.call("uploadMission", [north + 0.01, east, 5.0])
    flight.leg = asyncio.ensure_future(flight.call("startMission"))
    flight.leg.add_done_callback(lambda leg: leg.exception())
    await wait_for_mode(flight, "AUTO")


async def enter_circle_mode(flight):
    await flight.call("setMode", "CIRCLE")


@pytest.mark.parametrize("enter_mode", [start_long_mission, enter_circle_mode])
@scenario("fly")
async def test_guard_restart_lands_a_flight_of_the_program_in_any_mode(flight, /, desk, enter_mode):
    await take_off(flight)
    await enter_mode(flight)
    # Twice: the second restarted guard has no more information than the first.
    for _ in range(2):
        dead = flight.guard_pid
        desk.kill(dead)
        await flight.until(lambda dead=dead: flight.guard_pid not in (0, dead), 20.0, "the next guard")
    await flight.until_note(f"in safe state 'land': {RESTART_REASON}")
    await wait_for_mode(flight, "LAND")
    await flight.reads("armed", lambda now: now is False)
    assert not any("not commanded: the vehicle is in" in note for note in flight.notes)


@pytest.mark.few(1)
@pytest.mark.parametrize("restarts", [1, 2])
@scenario("fly", rest_within=2.0)
async def test_guard_restart_leaves_a_pilot_in_control(flight, /, desk, restarts):
    # In LOITER without a transmitter a copter sinks at 2.5 m/s; it must not reach the ground.
    await take_off(flight, 40.0)
    await change_mode_as_pilot(flight, "LOITER")
    await wait_for_mode(flight, "LOITER")
    for previous in range(restarts):
        desk.kill(flight.guard_pid)
        # Each guard must work before it is killed: after 2 s without heartbeats the autopilot's own
        # failsafe lands.
        await flight.until(
            lambda previous=previous: sum("not commanded: " in note for note in flight.notes) > previous,
            20.0,
            "the next guard",
        )
        await asyncio.sleep(2.0)
    pilot_control = "flown by a pilot in LOITER, "
    await flight.until(lambda: (flight.moving or "").startswith(pilot_control), 20.0, "the pilot's control")
    await asyncio.sleep(3.0)
    assert flight.query("mode") == "LOITER"
    assert any("not commanded: the vehicle is in" in note for note in flight.notes)


@scenario("fly")
async def test_guard_restart_lands_a_flight_returned_to_the_program(flight, /, desk):
    await take_off(flight)
    await change_mode_as_pilot(flight, "LOITER")
    await wait_for_mode(flight, "LOITER")
    await flight.call("release")
    desk.kill(flight.guard_pid)
    await flight.until_note(f"in safe state 'land': {RESTART_REASON}")
    await wait_for_mode(flight, "LAND")
