"""Stops that come while an arming, or the silence of the vehicle, is not known yet."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError


def slow(bench, seconds):
    """What the driver sends takes so long to arrive."""
    for link in bench.links:
        deliver, loop = link._deliver, asyncio.get_running_loop()
        link._deliver = lambda data, deliver=deliver, loop=loop: loop.call_later(seconds, deliver, data)


@pytest.mark.few(4)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@pytest.mark.parametrize("there", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("back", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("after", [0.0, 0.05, 0.3])
@on_bench("bench", given="flavour")
async def test_an_arming_that_is_under_way_at_a_stop_does_not_outlive_it(
    b, fc, /, flavour, there, back, after
):
    slow(b, there)
    b.faults.apply([f"delay={back}"])
    await asyncio.sleep(3.0)
    arming = asyncio.create_task(fc.execute("arm", []))
    await asyncio.sleep(after)
    arming.cancel()
    await safe(fc)
    assert fc.moving() == ""
    for _ in range(50):
        await asyncio.sleep(0.1)
        assert not b.autopilot.armed


async def safe(fc):
    """Made safe as the guard does it: again until it is confirmed, and until it is at rest."""
    for _ in range(20):
        try:
            await fc.make_safe()
        except DeviceError:
            await asyncio.sleep(1.0)
            continue
        if not fc.moving():
            return
        await asyncio.sleep(2.0)
    pytest.fail(fc.moving())


@pytest.mark.parametrize("before", [0.3, 1.0, 2.0])
@on_bench("bench")
async def test_a_vehicle_that_fell_silent_before_a_stop_has_not_been_seen(b, fc, /, before):
    b.cut = True
    await asyncio.sleep(before)
    begun = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="no heartbeat for"):
        await fc.make_safe()
    assert asyncio.get_running_loop().time() - begun < 3.0
    b.cut = False
    await fc.make_safe()


@on_bench("bench")
async def test_one_that_is_silent_in_the_hands_of_a_pilot_has_not_been_seen(b, fc, /):
    await fc.execute("arm", [])
    await fc.execute("takeoff", [4.0])
    b.autopilot.command_mode("LOITER")
    await asyncio.sleep(2.0)
    b.cut = True
    await asyncio.sleep(0.3)
    with pytest.raises(DeviceError, match="no heartbeat for"):
        await fc.make_safe()
    assert not any("not commanded: it is in" in note for note in b.notes)


@on_bench("bench")
async def test_a_vehicle_that_stands_with_its_motors_off_is_seen_within_a_heartbeat(b, fc, /):
    begun = asyncio.get_running_loop().time()
    await fc.make_safe()
    assert asyncio.get_running_loop().time() - begun <= 1.0


@on_bench("bench")
async def test_what_flies_is_told_to_land_at_once(b, fc, /):
    await fc.execute("arm", [])
    await fc.execute("takeoff", [4.0])
    making = asyncio.create_task(fc.make_safe())
    await asyncio.sleep(0.02)
    assert b.autopilot.mode == "LAND"
    await making


@on_bench("bench")
async def test_one_that_arms_although_it_said_that_its_motors_are_off_is_disarmed(b, fc, /):
    """An arming that nobody here has sent: seen by the heartbeat that the stop waits for."""
    b.autopilot.command_mode("GUIDED")
    b.autopilot.arm()
    assert fc.moving() == "", "it is not heard of yet"
    await fc.make_safe()
    assert not b.autopilot.armed
