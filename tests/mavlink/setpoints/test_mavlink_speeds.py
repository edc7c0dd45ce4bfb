"""The speed over ground in steady motion, on fakes with the speeds of real vehicles."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield_sim.autopilot.vehicle import Response

#: The permitted excess over the limit of a binding in still air, and in 9 m/s of wind.
STILL_AIR, WINDY = 1.05, 1.08
VEHICLES = [("ardupilot", "copter"), ("ardupilot", "rover"), ("px4", "copter"), ("px4", "rover")]


async def flown(b, fc, kind):
    """The speeds over ground on the way to a goal, from 5 s on until near the goal."""
    down = -8.0 if kind == "copter" else 0.0
    await fc.execute("arm", [])
    if kind == "copter":
        await fc.execute("takeoff", [8.0])
    flight, speeds = asyncio.create_task(fc.execute("goTo", [90.0, 0.0, down])), []
    start = b.autopilot.now
    while not flight.done():
        await asyncio.sleep(0.1)
        if b.autopilot.now - start > 5.0 and b.autopilot.vehicle.place[0] < 80.0:
            speeds.append(math.hypot(*b.autopilot.vehicle.velocity[:2]))
    await flight
    return speeds


@pytest.mark.few(1)
@pytest.mark.parametrize("limit", [1.0, 2.0, 3.0, 5.0])
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
def test_speed_limit_is_kept_in_still_air(bench, flavour, kind, limit):
    b = bench(flavour=flavour, kind=kind, limits={"speed": limit})
    speeds = b.run(lambda fc: flown(b, fc, kind))
    assert max(speeds) <= limit * STILL_AIR
    # PX4's copter reaches it within 20 s; its rover has at most 3 m/s.
    assert max(speeds) >= 0.95 * min(limit, 3.0 if (flavour, kind) == ("px4", "rover") else limit)
    assert [note for note in b.notes if "beyond its limit" in note] == []


@pytest.mark.few(0)
@pytest.mark.parametrize("source", [0.0, 1.57, 3.14])
@pytest.mark.parametrize(("flavour", "kind"), VEHICLES)
def test_speed_limit_is_kept_in_wind(bench, flavour, kind, source):
    b = bench(flavour=flavour, kind=kind, limits={"speed": 3.0}, faults=("wind=9", f"wind_from={source}"))
    assert max(b.run(lambda fc: flown(b, fc, kind))) <= 3.0 * WINDY


def test_flight_faster_than_commanded_is_corrected(bench):
    """ArduCopter in 9 m/s of wind: 3.16 m/s for a limit of 3 m/s."""
    b = bench(limits={"speed": 3.0})
    b.autopilot.vehicle.limits.goal_response = Response(1.055)
    assert max(b.run(lambda fc: flown(b, fc, "copter"))) <= 3.0 * 1.02


@pytest.mark.few(1)
@pytest.mark.parametrize("speed", [2.0, 3.0])
def test_rover_approaches_its_speed_without_overshoot(bench, speed):
    """A real rover drove 2.22 m/s for 2 m/s, and 3.44 m/s for 3 m/s."""
    b = bench(kind="rover", limits={"speed": speed})

    async def scenario(fc):
        await fc.execute("arm", [])
        flight, fastest = asyncio.create_task(fc.execute("goTo", [60.0, 0.0, 0.0])), 0.0
        while not flight.done():
            await asyncio.sleep(0.05)
            fastest = max(fastest, math.hypot(*b.autopilot.vehicle.velocity[:2]))
        return fastest

    assert b.run(scenario) <= speed * STILL_AIR


async def steady(b, task, seconds=8.0):
    """The greatest one-second mean speed, from `seconds` on until the task ends."""
    start, speeds = b.autopilot.now, []
    while not task.done():
        await asyncio.sleep(0.1)
        if b.autopilot.now - start > seconds:
            speeds.append(math.hypot(*b.autopilot.vehicle.velocity[:2]))
    await task
    return max(sum(speeds[n : n + 10]) / 10.0 for n in range(len(speeds) - 9))


@pytest.mark.few(2)
@pytest.mark.parametrize("limit", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_rover_drives_a_velocity_at_its_speed(bench, flavour, limit):
    b = bench(flavour=flavour, kind="rover", limits={"speed": limit})

    async def scenario(fc):
        async def drive():
            for _ in range(80):
                await fc.execute("setVelocity", [limit * 0.6, limit * 0.8, 0.0])
                await asyncio.sleep(0.2)

        await fc.execute("arm", [])
        return await steady(b, asyncio.create_task(drive()))

    assert 0.9 * limit < b.run(scenario) <= STILL_AIR * limit
    assert [note for note in b.notes if "beyond its limit" in note] == []


@pytest.mark.few(1)
@pytest.mark.parametrize("way", ["mission", "return", "goTo", "setSpeed"])
def test_px4_rover_keeps_a_low_speed_in_every_motion(bench, way):
    b, limit = bench(flavour="px4", kind="rover", limits={"speed": 1.0 if way != "goTo" else 0.5}), 1.0

    async def scenario(fc):
        nonlocal limit
        await fc.execute("arm", [])
        if way == "mission":
            latitude, longitude, _ = b.values["globalPosition"]
            await fc.execute("uploadMission", [[latitude + 2e-3, longitude, 0.0]])
            await fc.execute("startMission", [])
            return await steady(b, asyncio.create_task(asyncio.sleep(20.0)))
        flight = asyncio.create_task(fc.execute("goTo", [25.0, 0.0, 0.0]))
        if way == "return":
            await flight
            return await steady(b, asyncio.create_task(fc.execute("returnHome", [])))
        limit = 0.5 if way == "goTo" else 0.8
        if way == "setSpeed":
            await asyncio.sleep(5.0)
            await fc.execute("setSpeed", [limit])
        return await steady(b, flight)

    assert b.run(scenario) <= STILL_AIR * limit


@pytest.mark.few(0)
@on_bench("bench", flavour="px4", limits={"speed": 0.5})
async def test_slow_orbit_reaches_its_circle(b, fc, /):
    await up(fc, 8.0)
    await fc.execute("orbit", [0.0, 0.0, -8.0, 12.0, 0.5, 0.1])


@pytest.mark.few(1)
@pytest.mark.parametrize(("asked", "own"), [(None, 2.0), (None, 3.0), (2.0, 3.0), (3.0, 1.0)])
def test_rover_mission_does_not_overshoot_its_speed(bench, asked, own):
    """A real rover drove 2.22 m/s for 2 m/s by DO_CHANGE_SPEED, and 2.05 m/s by WP_SPEED."""
    b = bench(kind="rover", limits={"speed": 3.0 if asked else own})
    b.autopilot.parameters["WP_SPEED"] = own

    async def scenario(fc):
        if asked:
            await fc.execute("setSpeed", [asked])
        places = [b.fakes[1].place.at(*place) for place in ((40.0, 0.0), (40.0, 40.0), (0.0, 40.0))]
        way = [part for lat, lon in places for part in (lat / 1e7, lon / 1e7, 0.0)]
        await fc.execute("uploadMission", [way])
        await fc.execute("arm", [])
        await fc.execute("startMission", [])
        fastest = 0.0
        async with asyncio.timeout(150.0):
            while b.values["missionReached"] < 2:
                await asyncio.sleep(0.05)
                fastest = max(fastest, math.hypot(*b.autopilot.vehicle.velocity[:2]))
        return fastest

    expected = asked or own
    assert 0.85 * expected < b.run(scenario) <= expected * STILL_AIR
