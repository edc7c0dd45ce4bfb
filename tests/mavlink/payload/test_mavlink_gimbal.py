"""Gimbal protocol v2: directions, frames, regions of interest, control, ranges, a gimbal with MAVLink."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench

from lfield.errors import DeviceError
from lfield_mavlink.link.dialect import COMPONENT, dialect
from lfield_mavlink.payload.gimbal_attitude import GimbalAttitude, GimbalManager, direction
from lfield_sim.autopilot.equipment.payload import Payload

#: Another station.
OTHER = (245, 190)


def attached(flavour):
    """Attach a gimbal: ArduPilot's is connected to outputs, PX4's has a component id."""
    return {} if flavour == "ardupilot" else {"payload": Payload(frozenset({"mavlink_gimbal"}))}


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_it_is_done_when_the_gimbal_points_there(bench, flavour):
    b = bench(flavour=flavour, **attached(flavour))
    gimbal = b.autopilot.payload.gimbal

    async def mission(fc):
        start = asyncio.get_running_loop().time()
        await fc.execute("pointGimbal", [-1.5, 2.5])
        # At 90 degrees per second.
        assert asyncio.get_running_loop().time() - start > 1.4
        assert (gimbal.pitch, gimbal.yaw) == pytest.approx((-1.5, 2.5), abs=0.06)
        assert gimbal.primary == (fc.station, COMPONENT)
        angles = await fc.execute("gimbalAttitude", [])
        assert angles == pytest.approx([0.0, -1.5, 2.5], abs=0.06)
        b.autopilot.vehicle.yaw = 1.0
        await asyncio.sleep(1.0)
        await fc.execute("pointGimbalHeading", [-0.5, 1.5])
        assert gimbal.yaw == pytest.approx(0.5, abs=0.06)
        assert (await fc.execute("gimbalAttitude", []))[2] == pytest.approx(0.5, abs=0.06)
        b.autopilot.vehicle.yaw = 2.0
        await asyncio.sleep(2.0)
        assert gimbal.yaw == pytest.approx(-0.5, abs=0.06)

    b.run(mission)


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_a_region_of_interest_is_followed_until_it_is_released(bench, flavour):
    b = bench(flavour=flavour, **attached(flavour))
    gimbal = b.autopilot.payload.gimbal

    async def mission(fc):
        await fc.execute("pointGimbalAt", [10.0, 10.0, 0.0])
        assert gimbal.target == pytest.approx((10.0, 10.0, 0.0), abs=0.2)
        assert gimbal.yaw == pytest.approx(math.pi / 4.0, abs=0.06)
        latitude, longitude, _ = b.values["globalPosition"]
        await fc.execute("pointGimbalAtGlobal", [latitude, longitude + 1e-3, 0.0])
        assert gimbal.yaw == pytest.approx(math.pi / 2.0, abs=0.06)
        b.autopilot.vehicle.yaw = 1.0
        await asyncio.sleep(1.0)
        assert gimbal.yaw == pytest.approx(math.pi / 2.0 - 1.0, abs=0.06)
        await fc.execute("releaseGimbal", [])
        assert (gimbal.target, gimbal.primary) == (None, (0, 0))

    b.run(mission)


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
def test_another_station_in_control_is_an_error_until_control_is_taken(bench, flavour):
    b = bench(flavour=flavour)
    gimbal = b.autopilot.payload.gimbal

    async def mission(fc):
        gimbal.primary = OTHER
        for instruction, arguments in (("pointGimbal", [-0.5, 0.0]), ("pointGimbalAt", [9.0, 0.0, 0.0])):
            with pytest.raises(DeviceError, match="system 245, component 190 controls the gimbal") as raised:
                await fc.execute(instruction, arguments)
            assert raised.value.kind == "DeviceException"
        assert (gimbal.pitch_goal, gimbal.target) == (0.0, None)
        # A gimbal under the control of another station is not released.
        gimbal.target = (1.0, 2.0, 3.0)
        await fc.execute("releaseGimbal", [])
        assert (gimbal.primary, gimbal.target) == (OTHER, (1.0, 2.0, 3.0))
        await fc.execute("acquireGimbal", [])
        await fc.execute("pointGimbal", [-0.5, 0.0])
        assert gimbal.pitch == pytest.approx(-0.5, abs=0.06)

    b.run(mission)


@on_bench("bench", faults=("gimbal_secret=true",))
async def test_an_unknown_controller_is_an_error_until_control_is_taken(b, fc, /):
    gimbal = b.autopilot.payload.gimbal
    gimbal.primary = OTHER
    with pytest.raises(DeviceError, match="does not report which station controls the gimbal; acquireGimbal"):
        await fc.execute("pointGimbal", [-0.5, 0.0])
    await fc.execute("releaseGimbal", [])
    assert (gimbal.primary, gimbal.pitch_goal) == (OTHER, 0.0)
    await fc.execute("acquireGimbal", [])
    await fc.execute("pointGimbal", [-0.5, 0.0])
    assert (gimbal.primary, gimbal.pitch) == ((fc.station, COMPONENT), pytest.approx(-0.5, abs=0.06))
    await fc.execute("releaseGimbal", [])
    assert gimbal.primary == (0, 0)
    with pytest.raises(DeviceError, match="pointGimbalAt refused: component 1 does not report"):
        await fc.execute("pointGimbalAt", [9.0, 0.0, 0.0])


@on_bench("bench")
async def test_beyond_its_range_nothing_is_sent_and_at_its_end_it_is_an_error(b, fc, /):
    gimbal = b.autopilot.payload.gimbal
    for instruction in ("pointGimbal", "pointGimbalHeading"):
        with pytest.raises(DeviceError, match=r"a pitch of 1.00 is outside its range of -1.57 to 0.52 rad"):
            await fc.execute(instruction, [1.0, 0.0])
    with pytest.raises(DeviceError, match=r"a yaw of 3.10 is outside its range"):
        await fc.execute("pointGimbal", [0.0, 3.1])
    assert (gimbal.pitch_goal, gimbal.yaw_goal, gimbal.primary) == (0.0, 0.0, (0, 0))
    with pytest.raises(DeviceError, match="it may be at the end of its range"):
        await fc.execute("pointGimbalAt", [1.0, 0.0, -100.0])


@pytest.mark.parametrize("flavour", ["ardupilot", "px4"])
@on_bench("bench", payload=Payload(frozenset()), given="flavour")
async def test_without_a_gimbal_it_is_an_error_that_says_what_is_missing(b, fc, /, flavour):
    for instruction, arguments in (
        ("pointGimbal", [0.0, 0.0]), ("acquireGimbal", []), ("releaseGimbal", []), ("gimbalAttitude", [])
    ):  # fmt: skip
        with pytest.raises(DeviceError, match=f"{instruction} refused: no gimbal"):
            await fc.execute(instruction, arguments)
    assert b.autopilot.payload.gimbal.pitch_goal == 0.0


@on_bench("bench", faults=("loss=0.2",))
async def test_reports_that_are_lost_are_requested_again(b, fc, /):
    for pitch in (-0.3, -0.6, 0.0):
        await fc.execute("pointGimbal", [pitch, 0.0])
        assert b.autopilot.payload.gimbal.pitch == pytest.approx(pitch, abs=0.06)


def _attitude(flags, yaw):
    rotation = [math.cos(yaw / 2.0), 0.0, 0.0, math.sin(yaw / 2.0)]
    return dialect.MAVLink_gimbal_device_attitude_status_message(
        0, 0, 0, flags, rotation, 0.0, 0.0, 0.0, 0, math.nan, math.nan, 1
    )


@pytest.mark.parametrize(
    ("flags", "yaw"),
    [(0, 2.0), (16, 1.0), (32, 2.0), (32 | 16, 2.0), (64, 1.0), (64 | 16, 1.0)],
)
def test_its_yaw_is_in_the_frame_of_its_flags(flags, yaw):
    assert GimbalAttitude.from_message(_attitude(flags, 2.0), 1.0).yaw == pytest.approx(yaw)
    assert GimbalAttitude.from_message(_attitude(flags, math.nan), 1.0) is None


def test_a_range_without_width_is_unknown():
    assert GimbalManager(1, 1, (0.0, 0.0), (math.nan, math.nan)).excess_reason(3.0, 3.0) == ""
    assert direction((0.0, 5.0, 5.0)) == pytest.approx((-math.pi / 4.0, math.pi / 2.0))
