"""Detection of rest in the safe states of servos."""

from __future__ import annotations

import asyncio
import re

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call
from msgspec.structs import replace

from lfield.errors import DeviceError


async def start_motion(device, *goals):
    """Switch the torque on, start a motion, and cancel its call after 0.3 s."""
    await call(device, "torque", True)
    await call(device, "setProfile", 1.0, 0.0)
    moving = asyncio.ensure_future(call(device, "moveTo", list(goals) if len(goals) > 1 else goals[0]))
    await asyncio.sleep(0.3)
    moving.cancel()


@on_bench(Bench)
async def test_turning_servo_reports_its_speed_and_rests_in_torque_hold(bench, servo, /):
    await start_motion(servo, 1.5)
    assert re.fullmatch(r"turning at \d\.\d rad/s", servo.moving()), servo.moving()
    await servo.make_safe()
    assert servo.moving() == ""


@on_bench(Bench, safe_state="torque_off")
async def test_servo_with_torque_off_is_at_rest_until_torque_returns(bench, servo, /):
    await start_motion(servo, 1.5)
    await servo.make_safe()
    # The last measurement may be too old; the driver reports motion until the next measurement.
    await asyncio.sleep(0.3)
    assert servo.moving() == ""
    bench.servos[1].table.put("torque_enable", 1)
    await asyncio.sleep(3.0)
    assert servo.moving() == "torque on again"


@on_bench(Bench, safe_state="torque_off")
async def test_servo_turned_by_an_external_force_is_not_at_rest(bench, servo, /):
    await start_motion(servo, 1.5)
    await servo.make_safe()
    for _ in range(20):
        bench.servos[1].motion.motor.speed, bench.servos[1].motion.resting = 2.0, False
        await asyncio.sleep(0.01)
    assert re.fullmatch(r"turning at \d\.\d rad/s", servo.moving()), servo.moving()


@pytest.mark.parametrize("state", ["torque_off", "torque_hold"])
@on_bench(Bench, 1, 2, 3, given="safe_state=state")
async def test_member_without_answer_is_reported_as_not_at_rest(bench, group, /, state):
    await start_motion(group, 1.5, 1.5, 1.5)
    await group.make_safe()
    await asyncio.sleep(0.3)
    assert group.moving() == ""
    bench.fault("dead@2=true")
    await asyncio.sleep(3.0)
    assert re.fullmatch(r"servo 2 no message for [23]\.\d s", group.moving()), group.moving()
    with pytest.raises(DeviceError, match="servo 2 does not answer"):
        await group.make_safe()
    bench.fault("dead@2=false")
    await asyncio.sleep(1.0)
    assert group.moving() == ""


@on_bench(Bench, 1, 2)
async def test_turning_members_are_reported(bench, group, /):
    await start_motion(group, 1.5, 1.5)
    assert re.fullmatch(r"servo 1 turning at [\d.]+ rad/s, servo 2 turning at .*", group.moving())


@on_bench(Bench)
async def test_unplugged_adapter_means_not_at_rest(bench, servo, /):
    await call(servo, "torque", True)
    await servo.make_safe()
    assert servo.moving() == ""
    bench.port.unplug()
    await asyncio.sleep(3.0)
    assert re.fullmatch(r"no message for [23]\.\d s", servo.moving()), servo.moving()


@on_bench(Bench, safe_state="torque_off")
async def test_measurement_before_a_stop_does_not_prove_rest(bench, servo, /):
    await start_motion(servo, 1.5)
    at, reading = servo._readings[1]
    servo._readings[1] = (at, replace(reading, velocity=0.0))  # the value before the motion
    turned = bench.servos[1].motion.motor.speed
    await servo.make_safe()
    report = servo.moving()
    assert servo._readings[1][0] > at
    assert turned
    assert bool(report) == (abs(servo._readings[1][1].velocity) > 0.2), report
