"""Falls, crashes, GPS loss and foreign targets: the driver on fakes that act as real autopilots did."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from takeoff import up

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import dialect

STACKS = ("ardupilot", "px4")
ONLY_POSITION = 0x0DF8


async def fails(b, work):
    """The time and reason of a motion that ends early."""
    loop = asyncio.get_running_loop()
    try:
        await work
    except DeviceError as error:
        return loop.time(), error.reason
    pytest.fail("the motion ended without an error")


def at(seconds, do, *values):
    """Schedules a call; returns its time on the loop's clock."""
    loop = asyncio.get_running_loop()
    loop.call_later(seconds, do, *values)
    return loop.time() + seconds


def foreign(b, message, system=77):
    """A message of another station to the vehicle."""
    data = bytes(message.pack(dialect.MAVLink(None, srcSystem=system, srcComponent=190)))
    for fake in b.fakes.values():
        fake.receive("another link", data)
    return data


def setpoint(north, east, down):
    return dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, ONLY_POSITION, north, east, down, *[0.0] * 8
    )


def reposition(b, north, east, height):
    place = next(iter(b.fakes.values())).place
    return dialect.MAVLink_command_int_message(
        1, 1, 0, dialect.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, math.nan,
        *place.at(north, east), place.altitude + height,
    )  # fmt: skip


# -- foreign targets ----------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [False, True])
@on_bench("bench")
async def test_one_foreign_setpoint_is_a_takeover_within_two_seconds(b, fc, /, known):
    """ArduCopter follows the last setpoint of any sender without a report; one setpoint is enough."""
    await up(fc, 8.0)

    def interferes():
        data = foreign(b, setpoint(-20.0, -20.0, -8.0))
        if known:
            b.links[0].on_data(data)

    started = at(6.25, interferes)
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert ended - started < 2.0
    assert "another station has sent it elsewhere" in reason
    assert ("system 77" in reason) == known
    assert fc.taken_over()
    with pytest.raises(
        DeviceError, match=r"goTo refused: another station .* release\(\) takes control again"
    ):
        await fc.execute("goTo", [60.0, 0.0, -8.0])
    mode = b.autopilot.mode
    await fc.make_safe()
    assert b.autopilot.mode == mode, "left to the other station, like a mode of a pilot"
    await fc.execute("release", [])
    await fc.execute("goTo", [20.0, 0.0, -8.0])


@on_bench("bench")
async def test_continuous_foreign_setpoints_end_the_motion(b, fc, /):
    await up(fc, 8.0)

    async def interfere():
        while True:
            foreign(b, setpoint(-20.0, -20.0, -8.0))
            await asyncio.sleep(0.05)

    other = asyncio.create_task(interfere())
    started = asyncio.get_running_loop().time()
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert "another station" in reason or "flies away from its goal" in reason
    assert ended - started < 4.0
    other.cancel()


@on_bench("bench", flavour="px4", limits={"speed": 3.0})
async def test_foreign_reposition_of_px4_in_flight_is_a_takeover(b, fc, /):
    await up(fc, 8.0)
    started = at(6.0, lambda: foreign(b, reposition(b, -20.0, 0.0, 8.0)))
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert ended - started < 2.0
    assert "AUTO.LOITER" in reason
    assert "system" not in reason, "its messages are not received here"
    assert fc.taken_over()


@on_bench("bench", flavour="px4", limits={"speed": 3.0})
async def test_foreign_setpoints_to_px4_in_offboard_are_a_takeover(b, fc, /):
    await up(fc, 8.0)

    async def interfere():
        await asyncio.sleep(6.01)
        while True:
            foreign(b, setpoint(-20.0, -20.0, -8.0))
            await asyncio.sleep(0.03)

    other = asyncio.create_task(interfere())
    started = asyncio.get_running_loop().time() + 6.0
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert ended - started < 2.0
    assert "another station has sent it elsewhere" in reason
    assert not b.driver.devices["a1.fc"].motion.stream.is_running, "the driver stops its own setpoints"
    other.cancel()


@pytest.mark.few(0)
@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", faults=("loss=0.2", "delay=0.25"), limits={"speed": 3.0}, ttl=1.0, given="flavour")
async def test_own_goals_on_a_bad_link_are_no_takeover(b, fc, /, flavour):
    await up(fc, 8.0)
    for goal in ((12.0, 0.0, -8.0), (0.0, 9.0, -5.0), (0.0, 0.0, -8.0)):
        await fc.execute("goTo", list(goal))
    await fc.execute("land", [])
    assert not [note for note in b.notes if "taken over" in note or "falling" in note]
    assert b.lock_outs == []


# -- falls and crashes --------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("flavour", STACKS)
@pytest.mark.parametrize("goal", [(60.0, 0.0, -8.0), (60.0, 0.0, -20.0)])
@on_bench("bench", limits={"speed": 3.0}, given="flavour")
async def test_weak_motor_ends_a_motion_before_the_ground(b, fc, /, flavour, goal):
    await up(fc, 8.0)
    started = at(5.0, lambda: b.faults.apply(["motor_power=0.6"]))
    ended, reason = await fails(b, fc.execute("goTo", list(goal)))
    assert ended - started < 2.5
    assert "it falls" in reason or "it sinks" in reason
    assert b.autopilot.vehicle.airborne
    await asyncio.sleep(6.0)
    assert [refusal.startswith("it crashed: it hit the ground at 2.") for refusal in b.lock_outs] == [True]
    with pytest.raises(DeviceError, match=r"refused: it hit the ground .* estop --lift"):
        await fc.execute("goTo", [0.0, 0.0, -8.0])
    assert not await fc.execute("isReady", []) or b.autopilot.armed


@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", limits={"speed": 3.0}, given="flavour")
async def test_forced_disarm_in_flight_is_a_crash_and_blocks_arming(b, fc, /, flavour):
    await up(fc, 8.0)
    at(5.0, lambda: b.autopilot.disarm(force=True))
    _, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert "its motors went off in the air" in reason
    for what, values in (("arm", []), ("takeoff", [5.0])):
        with pytest.raises(DeviceError, match="Inspect it"):
            await fc.execute(what, values)
    assert "crashed" in await fc.execute("whyNotReady", [])
    (refusal,) = b.lock_outs
    assert refusal.startswith("it crashed: its motors went off in the air")
    await asyncio.sleep(3.0)
    # These calls pass the guard after an operator has ended the lock-out.
    await fc.execute("release", [])
    await fc.execute("waitReady", [20.0])
    await fc.execute("arm", [])


@pytest.mark.few(1)
@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", limits={"speed": 3.0}, waivers=("device_watchdog", "autonomous_motion"), given="flavour")
async def test_ordinary_landings_and_descents_are_no_crashes(b, fc, /, flavour):
    await up(fc, 12.0)
    await fc.execute("goTo", [10.0, 0.0, -3.0])
    await fc.execute("goTo", [0.0, 0.0, -12.0])
    await fc.execute("setVelocity", [0.0, 0.0, 1.0])
    await asyncio.sleep(0.3)
    await fc.execute("hold", [])
    await fc.execute("land", [])
    await fc.execute("arm", [])
    await fc.execute("disarm", [])
    await up(fc, 5.0)
    await fc.execute("goTo", [8.0, 0.0, -5.0])
    await fc.execute("returnHome", [])
    assert b.lock_outs == []
    assert not [note for note in b.notes if note.startswith(("falling", "crashed"))]


# -- position -----------------------------------------------------------------------------------------


@pytest.mark.few(2)
@pytest.mark.parametrize("flavour", STACKS)
@on_bench("bench", limits={"speed": 3.0, "radius": 100.0}, given="flavour")
async def test_gps_loss_ends_a_motion_within_two_seconds(b, fc, /, flavour):
    await up(fc, 8.0)
    started = at(5.0, lambda: b.faults.apply(["gps_loss=true"]))
    ended, reason = await fails(b, fc.execute("goTo", [60.0, 0.0, -8.0]))
    assert ended - started < 2.0
    assert "its GNSS fix is lost" in reason
    assert b.values["gpsFix"] < 3
    for what, values in (("goTo", [0.0, 0.0, -8.0]), ("hold", []), ("setVelocity", [1.0, 0.0, 0.0])):
        with pytest.raises(DeviceError, match=f"{what} refused: .*land\\(\\) needs no position"):
            await fc.execute(what, values)
    await asyncio.sleep(25.0)
    assert b.autopilot.mode in ("LAND", "AUTO.LAND") or not b.autopilot.armed
    assert b.breaches == [], "a drift is no breach of a limit"
    assert b.lock_outs == []


@pytest.mark.few(2)
@pytest.mark.parametrize("flavour", STACKS)
@pytest.mark.parametrize("state", ["hold", "return", "land"])
@on_bench("bench", given="flavour safe_state=state")
async def test_safe_state_without_position_is_a_landing(b, fc, /, flavour, state):
    await up(fc, 8.0)
    b.faults.apply(["gps_loss=true"])
    await asyncio.sleep(1.5)
    await fc.make_safe()
    assert b.autopilot.mode in ("LAND", "AUTO.LAND")


@pytest.mark.parametrize("fault", ["gps_glitch=33", "compass_failure=true"])
@on_bench("bench", limits={"speed": 3.0})
async def test_gps_glitch_or_compass_failure_does_not_end_a_motion(b, fc, /, fault):
    await up(fc, 8.0)
    at(3.0, lambda: b.faults.apply([fault]))
    await fc.execute("goTo", [30.0, 0.0, -8.0])
    assert b.lock_outs == [] == b.breaches


def test_refusal_after_a_crash_waits_until_the_motors_are_off(bench):
    """ArduCopter sends "Crash: Disarming" up to a second before its heartbeat shows the disarming."""
    b = bench()

    async def mission(fc):
        await up(fc, 15.0)
        asyncio.get_running_loop().call_later(2.0, b.faults.apply, ["motor_failure=true"])
        with pytest.raises(DeviceError, match="Crash: Disarming"):
            async with asyncio.timeout(20.0):
                await holds(fc)
        assert b.values["armed"] is False

    async def holds(fc):
        while True:
            await fc.execute("hold", [])
            await asyncio.sleep(0.2)

    b.run(mission)
