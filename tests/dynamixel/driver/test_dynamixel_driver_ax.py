"""AX-12A with protocol 1.0: no watchdog, no modes, no current measurement, errors in every answer."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call

from lfield.errors import DeviceError, DeviceNotSetUp


def ax(*ids: int, **more) -> Bench:
    return Bench(*ids, fake="AX-12A", protocol=1, waivers=["device_watchdog"], **more)


@on_bench(ax, 4, limits={"speed": 2.0})
async def test_ax_servo_moves_to_its_goal(bench, servo, /):
    assert "AX-12A 4" in await servo.open()
    await call(servo, "torque", True)
    await call(servo, "moveTo", 1.0)
    assert bench.values["position"] == pytest.approx(1.0, abs=0.02)
    assert math.isnan(bench.values["current"])
    await call(servo, "moveTo", -1.0)
    await servo.make_safe()


@pytest.mark.parametrize("instruction", ["moveTo", "setPosition"])
@on_bench(ax, 4, limits={"speed": 0.5})
async def test_first_motion_after_power_on_keeps_the_speed_limit(bench, servo, /, instruction):
    """After power-on, the speed register is 0, the maximum. The driver sends goal and speed in one packet."""
    await call(servo, "torque", True)
    motion = asyncio.ensure_future(call(servo, instruction, 1.0))
    for _ in range(100):
        await asyncio.sleep(0.02)
        assert abs(bench.values["velocity"]) < 0.6
    await motion
    assert bench.values["position"] == pytest.approx(1.0, abs=0.1)


@on_bench(Bench, 4, fake="AX-12A", protocol=1, opened=False)
async def test_ax_without_the_watchdog_waiver_is_refused(b, servo, /):
    with pytest.raises(DeviceError, match="no watchdog in the device"):
        await servo.open()


@on_bench(ax, 4, opened=False)
async def test_stored_setting_is_not_written_at_opening(bench, servo, /):
    bench.servos[4].table.put("status_return_level", 1)
    with pytest.raises(DeviceNotSetUp, match="status_return_level of servo 4 is 1 and must be 2"):
        await servo.open()
    assert bench.servos[4].table["status_return_level"] == 1
    (setting,) = await servo.settings()
    await servo.write_setting(setting.name, 2)
    await servo.open()
    await servo.write_setting(setting.name, 1)
    assert bench.servos[4].table["status_return_level"] == 1


@pytest.mark.parametrize(
    ("instruction", "match"),
    [
        (("mode", "velocity"), "it has no operating mode"),
        (("setVelocity", 1.0), "requires the mode velocity"),
        (("setCurrent", 0.1), "does not measure its current"),
        (("calibrate", 0.0), "it has no homing offset"),
        (("reboot",), "does not support reboot"),
        (("moveTo", 2.7), "only moves from -2.62"),
    ],
)
@on_bench(ax, 1)
async def test_unsupported_ax_instruction_is_refused(b, servo, /, instruction, match):
    await call(servo, "torque", True)
    with pytest.raises(DeviceError, match=match):
        await call(servo, *instruction)


@on_bench(ax, 1)
async def test_torque_hold_does_not_switch_the_torque_on(bench, servo, /):
    await servo.make_safe()
    await asyncio.sleep(1.0)
    assert not bench.values["torqueOn"]


@on_bench(ax, 1, 2, 3)
async def test_ax_group_is_stopped_by_one_packet(bench, group, /):
    await call(group, "torque", True)
    await call(group, "setProfile", 2.0, 0.0)
    await call(group, "moveTo", [0.5, -0.5, 0.2])
    assert bench.values["positions"] == pytest.approx([0.5, -0.5, 0.2], abs=0.02)
    moving = asyncio.ensure_future(call(group, "moveTo", [-1.0, 1.0, 1.0]))
    await asyncio.sleep(0.3)
    moving.cancel()
    bench.fault("dead@2=true")
    with pytest.raises(DeviceError, match="servo 2 does not answer"):
        await group.make_safe()
    stopped_at = bench.values["positions"][0]
    await asyncio.sleep(1.0)
    assert bench.values["positions"][0] == pytest.approx(stopped_at, abs=0.15)


@on_bench(ax, 1)
async def test_ax_overload_is_reported_and_reset(bench, servo, /):
    await call(servo, "torque", True)
    bench.fault("overload=true")
    with pytest.raises(DeviceError, match=r"has shut down: .*; torque\(true\) restores it"):
        await call(servo, "moveTo", 1.0)
    bench.fault("overload=false")
    await asyncio.sleep(2.0)
    await call(servo, "torque", True)
    await call(servo, "moveTo", 0.5)
