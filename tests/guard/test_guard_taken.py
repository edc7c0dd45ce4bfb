"""Whose vehicle it is when its guard dies: the program's, unless somebody else is known to have it."""

from __future__ import annotations

import asyncio
import os
import signal

import pytest
from pymavlink import mavutil
from test_guard_process import fake, flying

pytestmark = pytest.mark.process

AGAIN = "its guard died and was started again"


async def up(flight):
    await flight.call("arm")
    await flight.call("takeoff", 5.0)


async def mode_is(flight, mode):
    await flight.reads("mode", lambda now: now == mode)


def by_a_pilot(endpoint: str, mode: str) -> None:
    """Somebody else at the same vehicle, by a link of his own."""
    link = mavutil.mavlink_connection(endpoint.replace("udp:", "udpout:"), source_system=77)
    numbers = {name: number for number, name in mavutil.mode_mapping_acm.items()}
    link.mav.set_mode_send(1, mavutil.mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, numbers[mode])
    link.close()


async def in_a_mission(flight):
    """On a long leg of a mission, in AUTO."""
    north, east, _ = await flight.call("globalPosition")
    await flight.call("uploadMission", [north + 0.01, east, 5.0])
    flight.leg = asyncio.ensure_future(flight.call("startMission"))
    flight.leg.add_done_callback(lambda leg: leg.exception())
    await mode_is(flight, "AUTO")


async def in_loiter(flight):
    await flight.call("setMode", "LOITER")


@pytest.mark.parametrize("flown", [in_a_mission, in_loiter])
def test_what_the_program_flies_is_landed_in_any_mode(flown):
    async def mission():
        async with fake() as f, flying(f) as flight:
            await up(flight)
            await flown(flight)
            # Twice: the second guard knows no more than the first.
            for _ in range(2):
                os.kill(flight.guard_pid, signal.SIGKILL)
                await flight.until(lambda: not flight.guard_pid, 20.0, "the end of the guard")
                await flight.until(lambda: flight.guard_pid, 20.0, "the next guard")
            await flight.told(f"is in its safe state 'land': {AGAIN}")
            await mode_is(flight, "LAND")
            await flight.reads("armed", lambda now: now is False)
            assert not any("left to them" in note for note in flight.notes)

    asyncio.run(mission())


@pytest.mark.parametrize("times", [1, 2])
def test_what_a_pilot_flies_is_left_to_him(times):
    async def mission():
        async with fake() as f, flying(f, rest_within=2.0) as flight:
            await up(flight)
            by_a_pilot(f.endpoint, "LOITER")
            await mode_is(flight, "LOITER")
            for _ in range(times):
                pid = flight.guard_pid
                os.kill(pid, signal.SIGKILL)
                await flight.until(lambda pid=pid: flight.guard_pid not in (0, pid), 20.0, "the next guard")
                await flight.until(lambda: flight.moving, 20.0, "a word of it")
            assert flight.moving.startswith("flown by a pilot in LOITER, ")
            await asyncio.sleep(3.0)
            assert flight.query("mode") == "LOITER"
            assert any("left to them" in note for note in flight.notes)

    asyncio.run(mission())


def test_what_was_given_back_to_the_program_is_landed():
    async def mission():
        async with fake() as f, flying(f) as flight:
            await up(flight)
            by_a_pilot(f.endpoint, "LOITER")
            await mode_is(flight, "LOITER")
            await flight.call("release")
            os.kill(flight.guard_pid, signal.SIGKILL)
            await flight.told(f"is in its safe state 'land': {AGAIN}")
            await mode_is(flight, "LAND")

    asyncio.run(mission())
