"""A failsafe that has the vehicle in a mode that the program uses too: its, until release()."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect


async def up(fc, height=6.0):
    await fc.execute("arm", [])
    await fc.execute("takeoff", [height])


async def out_of_the_fence(b, fc, *, outwards=(3.0, 0.0, 0.0)):
    """Renew a velocity until that is refused; the reason."""
    for _ in range(400):
        try:
            await fc.execute("setVelocity", list(outwards))
        except DeviceError as refusal:
            return refusal.reason
        await asyncio.sleep(0.2)
    pytest.fail("it flies on")


def says(packet, kind):
    return any(message.get_msgId() == kind for message in Reader().feed(packet))


@pytest.mark.few(1)
@pytest.mark.parametrize("action", ["hold", "land", "return"])
@on_bench("bench", flavour="px4", ttl=3.5, limits={"speed": 3.0})
async def test_a_breach_of_px4s_fence_takes_the_vehicle_until_it_is_released(b, fc, /, action):
    await fc.execute("fenceAction", [action])
    b.autopilot.parameters["GF_MAX_HOR_DIST"] = 15.0
    await up(fc)
    reason = await out_of_the_fence(b, fc)
    assert "its failsafe, instead of OFFBOARD, has it (Geofence: exceeding maximum distance" in reason
    assert "Failsafe activated" in reason
    for what, values in (("setVelocity", [3.0, 0.0, 0.0]), ("goTo", [5.0, 0.0, -6.0]), ("hold", [])):
        with pytest.raises(DeviceError, match=f"{what} refused: .* release"):
            await fc.execute(what, values)
    assert fc.taken_over()
    mode = b.autopilot.mode
    await fc.make_safe()
    assert b.autopilot.mode == mode
    assert any("it is 1" in n and "its own fence GF_MAX_HOR_DIST ends at 15 m" in n for n in b.notes)
    await fc.execute("release", [])
    assert not fc.taken_over()
    await fc.execute("setVelocity", [-3.0, 0.0, 0.0])
    assert b.autopilot.mode == "OFFBOARD"
    await asyncio.sleep(3.0)
    await fc.execute("goTo", [5.0, 0.0, -6.0])


@on_bench("bench", flavour="px4", ttl=3.5, limits={"speed": 3.0})
async def test_an_orbit_that_px4s_fence_ended_says_so_and_is_not_taken_from_it(b, fc, /):
    """It is pushed out: what is told before is refused before."""
    await up(fc)
    asyncio.get_running_loop().call_later(20.0, lambda: b.autopilot.parameters.update(GF_MAX_HOR_DIST=8.0))
    with pytest.raises(DeviceError, match=r"to AUTO.LOITER, which its failsafe chose.*Geofence: exc"):
        await fc.execute("orbit", [0.0, 0.0, -6.0, 12.0, 2.0, 3.0])
    with pytest.raises(DeviceError, match=r"setVelocity refused: .*its failsafe, instead of OFFBOARD"):
        await fc.execute("setVelocity", [3.0, 0.0, 0.0])
    await asyncio.sleep(10.0)
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 16.0


@on_bench("bench", flavour="px4")
async def test_words_that_come_after_the_mode_are_waited_for(b, fc, /):
    await up(fc)
    loop = asyncio.get_running_loop()

    def later(link, packet):
        late = 0.2 if says(packet, dialect.MAVLINK_MSG_ID_STATUSTEXT) else 0.0
        loop.call_later(late, link.on_data, packet)

    b.filter = later
    loop.call_later(9.0, lambda: b.autopilot.parameters.update(GF_MAX_HOR_DIST=8.0))
    with pytest.raises(DeviceError, match=r"Geofence: exceeding maximum distance"):
        await fc.execute("orbit", [0.0, 0.0, -6.0, 12.0, 2.0, 3.0])


@pytest.mark.parametrize("kept", ["texts", "heartbeats"])
@on_bench("bench", flavour="px4", safe_state="hold")
async def test_a_hold_that_was_to_hold_is_told_by_words_and_by_the_heartbeat(b, fc, /, kept):
    """Nothing is intended otherwise: PX4 has lost its station while it stays where it was told to."""
    lost = dialect.MAVLINK_MSG_ID_STATUSTEXT

    await up(fc)
    await fc.execute("goTo", [3.0, 0.0, -6.0])
    if kept == "heartbeats":
        b.filter = lambda link, packet: None if says(packet, lost) else link.on_data(packet)
    b.driver.quiet()
    await asyncio.sleep(9.0)
    b.driver.resume()
    await asyncio.sleep(1.2)
    with pytest.raises(DeviceError, match=r"its failsafe.* has it"):
        await fc.execute("goTo", [0.0, 0.0, -6.0])
    await fc.execute("release", [])
    await asyncio.sleep(2.0)
    await fc.execute("goTo", [0.0, 0.0, -6.0])


@pytest.mark.parametrize(("action", "own"), [("hold", "hold"), ("return", "returnHome"), ("land", "land")])
@on_bench("bench")
async def test_ardupilots_fence_takes_it_in_the_mode_of_the_program(b, fc, /, action, own):
    await up(fc, 20.0)
    await fc.execute("fenceAction", [action])
    await fc.execute("goTo", [20.0, 0.0, -20.0])
    under_way = asyncio.create_task(fc.execute(own, []))
    await asyncio.sleep(3.0)
    assert not fc.taken_over()
    b.autopilot.parameters.update(FENCE_ENABLE=1.0, FENCE_RADIUS=10.0)
    await asyncio.sleep(1.5)
    assert fc.taken_over()
    with pytest.raises(DeviceError, match=r"its failsafe has it .Circle fence breached.. release"):
        await fc.execute("goTo", [0.0, 0.0, -20.0])
    await fc.execute("release", [])
    await fc.execute("goTo", [5.0, 0.0, -20.0])
    under_way.cancel()


@on_bench("bench", ttl=1.0)
async def test_a_failsafe_that_an_ardupilot_lands_on_with_has_it(b, fc, /):
    await up(fc, 20.0)
    under_way = asyncio.create_task(fc.execute("land", []))
    await asyncio.sleep(2.0)
    b.driver.quiet()
    await asyncio.sleep(3.5)
    b.driver.resume()
    assert fc.taken_over()
    # It lands all the same, and may be armed then.
    await under_way
    assert not fc.taken_over()
    await up(fc, 3.0)


@on_bench("bench", flavour="px4")
async def test_one_that_a_failsafe_had_when_its_guard_died_is_its_after_that(b, fc, /):
    await up(fc)
    await fc.execute("setMode", ["AUTO.LOITER"])
    fc.guard_restarted(True)
    assert fc.taken_over()
    fc.guard_restarted(False)
    assert not fc.taken_over()


@on_bench("bench", flavour="px4")
async def test_what_is_said_of_a_failsafe_that_does_nothing_takes_nothing(b, fc, /):
    await up(fc)
    for text in (
        "GCS Failsafe Cleared",
        "Failsafe warning: battery low",
        "Reposition is outside geofence",
    ):
        b.autopilot.say(text)
        await asyncio.sleep(0.3)
        assert not fc.taken_over()
    # Its own word for it, but in a mode that no failsafe chooses.
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    b.autopilot.say("Failsafe activated")
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])


def test_a_battery_failsafe_is_left_alone_until_release_and_then_guided_is_flown(bench):
    """As the real one (gauntlet-a): GUIDED is obeyed again, it stays CRITICAL, and is not armed after it."""
    b = bench(limits={"speed": 3.0})
    b.autopilot.parameters |= {"BATT_FS_LOW_ACT": 1, "BATT_LOW_MAH": 660}

    async def mission(fc):
        await fc.execute("arm", [])
        await fc.execute("takeoff", [6.0])
        asyncio.get_running_loop().call_later(3.0, b.faults.apply, ["battery=0.19"])
        with pytest.raises(
            DeviceError, match=r"went to LAND, which its failsafe chose, Battery 1 is low .*, Batt"
        ):
            await fc.execute("goTo", [60.0, 0.0, -6.0])
        assert (b.values["mode"], b.values["failsafe"]) == ("LAND", True), "read where it is caught"
        assert fc.taken_over()
        with pytest.raises(
            DeviceError, match=r"goTo refused: .* its failsafe has it .*release\(\) takes control again"
        ):
            await fc.execute("goTo", [0.0, 0.0, -6.0])
        await fc.execute("release", [])
        await fc.execute("goTo", [12.0, 0.0, -6.0])
        assert b.values["failsafe"] is True
        assert not fc.taken_over(), "it acts once"
        await fc.execute("land", [])
        with pytest.raises(DeviceError, match=r"arm refused: .*Battery failsafe"):
            await fc.execute("arm", [])

    b.run(mission)
    assert b.lock_outs == []
