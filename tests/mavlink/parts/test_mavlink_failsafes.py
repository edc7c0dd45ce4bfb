"""A failsafe controls the vehicle in a mode that the program also uses, until release()."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import Reader, dialect


async def out_of_the_fence(b, fc, *, outwards=(3.0, 0.0, 0.0)):
    """Renews a velocity until it is refused; returns the reason."""
    for _ in range(400):
        try:
            await fc.execute("setVelocity", list(outwards))
        except DeviceError as refusal:
            return refusal.reason
        await asyncio.sleep(0.2)
    pytest.fail("the velocity was never refused")


def contains(packet, kind):
    return any(message.get_msgId() == kind for message in Reader().feed(packet))


@pytest.mark.few(1)
@pytest.mark.parametrize("action", ["hold", "land", "return"])
@on_bench("bench", flavour="px4", ttl=3.5, limits={"speed": 3.0})
async def test_px4_fence_breach_takes_control_until_release(b, fc, /, action):
    await fc.execute("fenceAction", [action])
    b.autopilot.parameters["GF_MAX_HOR_DIST"] = 15.0
    await up(fc, 6.0)
    reason = await out_of_the_fence(b, fc)
    assert (
        "its failsafe, instead of OFFBOARD, controls the vehicle (Geofence: exceeding maximum distance"
        in reason
    )
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


@pytest.mark.few(0)
@on_bench("bench", flavour="px4", ttl=3.5, limits={"speed": 3.0})
async def test_px4_fence_ends_an_orbit_and_keeps_control(b, fc, /):
    """The fence is set during the orbit: earlier commands would be refused earlier."""
    await up(fc, 6.0)
    asyncio.get_running_loop().call_later(20.0, lambda: b.autopilot.parameters.update(GF_MAX_HOR_DIST=8.0))
    with pytest.raises(DeviceError, match=r"to AUTO.LOITER, which its failsafe chose.*Geofence: exc"):
        await fc.execute("orbit", [0.0, 0.0, -6.0, 12.0, 2.0, 3.0])
    with pytest.raises(DeviceError, match=r"setVelocity refused: .*its failsafe, instead of OFFBOARD"):
        await fc.execute("setVelocity", [3.0, 0.0, 0.0])
    await asyncio.sleep(10.0)
    assert math.hypot(*b.autopilot.vehicle.place[:2]) < 16.0


@pytest.mark.few(0)
@on_bench("bench", flavour="px4")
async def test_status_text_after_the_mode_change_is_awaited(b, fc, /):
    await up(fc, 6.0)
    loop = asyncio.get_running_loop()

    def later(link, packet):
        late = 0.2 if contains(packet, dialect.MAVLINK_MSG_ID_STATUSTEXT) else 0.0
        loop.call_later(late, link.on_data, packet)

    b.filter = later
    loop.call_later(9.0, lambda: b.autopilot.parameters.update(GF_MAX_HOR_DIST=8.0))
    with pytest.raises(DeviceError, match=r"Geofence: exceeding maximum distance"):
        await fc.execute("orbit", [0.0, 0.0, -6.0, 12.0, 2.0, 3.0])


@pytest.mark.few(0)
@pytest.mark.parametrize("kept", ["texts", "heartbeats"])
@on_bench("bench", flavour="px4", safe_state="hold")
async def test_failsafe_in_the_same_hold_mode_is_detected(b, fc, /, kept):
    """PX4 has lost its station while it holds its commanded position: the mode does not change."""
    lost = dialect.MAVLINK_MSG_ID_STATUSTEXT

    await up(fc, 6.0)
    await fc.execute("goTo", [3.0, 0.0, -6.0])
    if kept == "heartbeats":
        b.filter = lambda link, packet: None if contains(packet, lost) else link.on_data(packet)
    b.driver.quiet()
    await asyncio.sleep(9.0)
    b.driver.resume()
    await asyncio.sleep(1.2)
    with pytest.raises(DeviceError, match=r"its failsafe.* controls the vehicle"):
        await fc.execute("goTo", [0.0, 0.0, -6.0])
    await fc.execute("release", [])
    await asyncio.sleep(2.0)
    await fc.execute("goTo", [0.0, 0.0, -6.0])


@pytest.mark.few(1)
@pytest.mark.parametrize(("action", "own"), [("hold", "hold"), ("return", "returnHome"), ("land", "land")])
@on_bench("bench")
async def test_ardupilot_fence_takes_control_in_the_mode_of_the_program(b, fc, /, action, own):
    await up(fc, 20.0)
    await fc.execute("fenceAction", [action])
    await fc.execute("goTo", [20.0, 0.0, -20.0])
    under_way = asyncio.create_task(fc.execute(own, []))
    await asyncio.sleep(3.0)
    assert not fc.taken_over()
    b.autopilot.parameters.update(FENCE_ENABLE=1.0, FENCE_RADIUS=10.0)
    await asyncio.sleep(1.5)
    assert fc.taken_over()
    with pytest.raises(
        DeviceError, match=r"its failsafe controls the vehicle .Circle fence breached.. release"
    ):
        await fc.execute("goTo", [0.0, 0.0, -20.0])
    await fc.execute("release", [])
    await fc.execute("goTo", [5.0, 0.0, -20.0])
    under_way.cancel()


@on_bench("bench", ttl=1.0)
async def test_failsafe_during_an_ardupilot_landing_takes_control(b, fc, /):
    await up(fc, 20.0)
    under_way = asyncio.create_task(fc.execute("land", []))
    await asyncio.sleep(2.0)
    b.driver.quiet()
    await asyncio.sleep(3.5)
    b.driver.resume()
    assert fc.taken_over()
    # It lands nevertheless, and can then be armed.
    await under_way
    assert not fc.taken_over()
    await up(fc, 3.0)


@on_bench("bench", flavour="px4")
async def test_failsafe_keeps_control_after_a_guard_restart(b, fc, /):
    await up(fc, 6.0)
    await fc.execute("setMode", ["AUTO.LOITER"])
    fc.guard_restarted(True)
    assert fc.taken_over()
    fc.guard_restarted(False)
    assert not fc.taken_over()


@on_bench("bench", flavour="px4")
async def test_status_text_of_an_inactive_failsafe_is_no_takeover(b, fc, /):
    await up(fc, 6.0)
    for text in (
        "GCS Failsafe Cleared",
        "Failsafe warning: battery low",
        "Reposition is outside geofence",
    ):
        b.autopilot.say(text)
        await asyncio.sleep(0.3)
        assert not fc.taken_over()
    # The text of an active failsafe, but in a mode that no failsafe chooses.
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])
    b.autopilot.say("Failsafe activated")
    await fc.execute("setVelocity", [1.0, 0.0, 0.0])


@pytest.mark.few(0)
def test_battery_failsafe_keeps_control_until_release(bench):
    """As recorded (gauntlet-a): GUIDED works again, the status stays CRITICAL, later arming is refused."""
    b = bench(limits={"speed": 3.0})
    b.autopilot.parameters |= {"BATT_FS_LOW_ACT": 1, "BATT_LOW_MAH": 660}

    async def mission(fc):
        await up(fc, 6.0)
        asyncio.get_running_loop().call_later(3.0, b.faults.apply, ["battery=0.19"])
        with pytest.raises(
            DeviceError, match=r"went to LAND, which its failsafe chose, Battery 1 is low .*, Batt"
        ):
            await fc.execute("goTo", [60.0, 0.0, -6.0])
        assert (b.values["mode"], b.values["failsafe"]) == ("LAND", True), (
            "the values are current where the exception is caught"
        )
        assert fc.taken_over()
        with pytest.raises(
            DeviceError,
            match=r"goTo refused: .* its failsafe controls the vehicle .*release\(\) takes control again",
        ):
            await fc.execute("goTo", [0.0, 0.0, -6.0])
        await fc.execute("release", [])
        await fc.execute("goTo", [12.0, 0.0, -6.0])
        assert b.values["failsafe"] is True
        assert not fc.taken_over(), "the failsafe acts once"
        await fc.execute("land", [])
        with pytest.raises(DeviceError, match=r"arm refused: .*Battery failsafe"):
            await fc.execute("arm", [])

    b.run(mission)
    assert b.lock_outs == []
