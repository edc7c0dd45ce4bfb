"""What servos still do in their safe states."""

from __future__ import annotations

import asyncio
import re
from dataclasses import replace

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call

from lfield.errors import DeviceError


async def under_way(device, *goals):
    """Stiff, and in the middle of a travel that nobody waits for any more."""
    await call(device, "torque", True)
    await call(device, "setProfile", 1.0, 0.0)
    moving = asyncio.ensure_future(call(device, "moveTo", list(goals) if len(goals) > 1 else goals[0]))
    await asyncio.sleep(0.3)
    moving.cancel()


@on_bench(Bench)
async def test_a_servo_that_turns_says_so_and_rests_when_it_is_held(bench, servo, /):
    await under_way(servo, 1.5)
    assert re.fullmatch(r"turning at \d\.\d rad/s", servo.moving()), servo.moving()
    await servo.make_safe()
    assert servo.moving() == ""


@on_bench(Bench, safe_state="torque_off")
async def test_a_servo_whose_torque_is_off_rests_when_it_stands_and_is_limp(bench, servo, /):
    await under_way(servo, 1.5)
    await servo.make_safe()
    # What was measured last may be a moment old: it still turns as far as is known.
    await asyncio.sleep(0.3)
    assert servo.moving() == ""
    bench.servos[1].table.put("torque_enable", 1)
    await asyncio.sleep(3.0)
    assert servo.moving() == "stiff again"


@on_bench(Bench, safe_state="torque_off")
async def test_a_limp_servo_that_is_turned_from_outside_is_not_at_rest(bench, servo, /):
    await under_way(servo, 1.5)
    await servo.make_safe()
    for _ in range(20):
        bench.servos[1].motion.motor.speed, bench.servos[1].motion.resting = 2.0, False
        await asyncio.sleep(0.01)
    assert re.fullmatch(r"turning at \d\.\d rad/s", servo.moving()), servo.moving()


@pytest.mark.parametrize("state", ["torque_off", "torque_hold"])
@on_bench(Bench, 1, 2, 3, given="safe_state=state")
async def test_a_member_that_does_not_answer_is_named(bench, group, /, state):
    await under_way(group, 1.5, 1.5, 1.5)
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
async def test_members_that_turn_are_named(bench, group, /):
    await under_way(group, 1.5, 1.5)
    assert re.fullmatch(r"servo 1 turning at [\d.]+ rad/s, servo 2 turning at .*", group.moving())


@on_bench(Bench)
async def test_an_adapter_that_is_unplugged_leaves_nobody_at_rest(bench, servo, /):
    await call(servo, "torque", True)
    await servo.make_safe()
    assert servo.moving() == ""
    bench.port.unplug()
    await asyncio.sleep(3.0)
    assert re.fullmatch(r"no message for [23]\.\d s", servo.moving()), servo.moving()


@on_bench(Bench, safe_state="torque_off")
async def test_what_was_measured_before_a_stop_is_no_rest(bench, servo, /):
    await under_way(servo, 1.5)
    at, seen = servo._readings[1]
    servo._readings[1] = (at, replace(seen, velocity=0.0))  # as it was before it set out
    turned = bench.servos[1].motion.motor.speed
    await servo.make_safe()
    told = servo.moving()
    assert servo._readings[1][0] > at
    assert turned
    assert bool(told) == (abs(servo._readings[1][1].velocity) > 0.2), told
