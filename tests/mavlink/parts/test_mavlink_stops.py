"""Stops during an unfinished arming, or during an undetected silence of the vehicle."""

from __future__ import annotations

import asyncio

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError


def slow(bench, seconds):
    """Delay the packets of the driver by some seconds."""
    for link in bench.links:
        deliver, loop = link._deliver, asyncio.get_running_loop()
        link._deliver = lambda data, deliver=deliver, loop=loop: loop.call_later(seconds, deliver, data)


@pytest.mark.few(4)
@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@pytest.mark.parametrize("there", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("back", [0.0, 0.4, 1.2])
@pytest.mark.parametrize("after", [0.0, 0.05, 0.3])
@on_bench("bench", given="flavour")
async def test_arming_in_progress_does_not_survive_a_stop(b, fc, /, flavour, there, back, after):
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
    """Repeats the safe state as the guard does, until it is confirmed and the vehicle is at rest."""
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
async def test_stop_of_a_silent_vehicle_is_not_confirmed(b, fc, /, before):
    b.cut = True
    await asyncio.sleep(before)
    start = asyncio.get_running_loop().time()
    with pytest.raises(DeviceError, match="no heartbeat for"):
        await fc.make_safe()
    assert asyncio.get_running_loop().time() - start < 3.0
    b.cut = False
    await fc.make_safe()


@on_bench("bench")
async def test_stop_of_a_silent_vehicle_under_pilot_control_fails(b, fc, /):
    await up(fc, 4.0)
    b.autopilot.command_mode("LOITER")
    await asyncio.sleep(2.0)
    b.cut = True
    await asyncio.sleep(0.3)
    with pytest.raises(DeviceError, match="no heartbeat for"):
        await fc.make_safe()
    assert not any("not commanded: the vehicle is in" in note for note in b.notes)


@on_bench("bench")
async def test_stop_of_a_disarmed_vehicle_takes_one_heartbeat(b, fc, /):
    start = asyncio.get_running_loop().time()
    await fc.make_safe()
    assert asyncio.get_running_loop().time() - start <= 1.0


@on_bench("bench")
async def test_stop_of_a_flying_vehicle_lands_at_once(b, fc, /):
    await up(fc, 4.0)
    making = asyncio.create_task(fc.make_safe())
    await asyncio.sleep(0.02)
    assert b.autopilot.mode == "LAND"
    await making


@on_bench("bench")
async def test_stop_disarms_a_vehicle_armed_by_another_station(b, fc, /):
    """The foreign arming is detected by the heartbeat that the stop waits for."""
    b.autopilot.command_mode("GUIDED")
    b.autopilot.arm()
    assert fc.moving() == "", "it is not reported yet"
    await fc.make_safe()
    assert not b.autopilot.armed
