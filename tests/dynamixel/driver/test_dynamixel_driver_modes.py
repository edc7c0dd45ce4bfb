"""Drive mode (address 10): the fake and the driver implement each value of the manual."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call

from lfield.errors import DeviceError
from lfield_sim.dynamixel.servo_model import DRIVE_MODES, DUAL_DRIVE_MODES
from lfield_sim.dynamixel.servo_motion import COUNTS

REVERSE, SLAVE, TIME_BASED, TORQUE_BY_GOAL = 1, 2, 4, 8


def in_mode(drive_mode: int, model: str = "XM430-W350", **more) -> Bench:
    bench = Bench(fake=model, **more)
    servo = bench.servos[1]
    servo.write(servo.model.items["drive_mode"].address, bytes([drive_mode]))
    return bench


def direction(drive_mode: int) -> int:
    return -1 if drive_mode & REVERSE else 1


@pytest.mark.few(0)
@pytest.mark.parametrize("drive_mode", DRIVE_MODES)
def test_motion_duration_and_direction_in_every_drive_mode(drive_mode):
    bench = in_mode(drive_mode, limits={"speed": 0.5})
    motor = bench.servos[1].motion.motor
    start_angle = motor.angle

    async def scenario(servo):
        assert bench.values["position"] == pytest.approx(0.0, abs=0.002)
        await call(servo, "torque", True)
        start, fastest = asyncio.get_running_loop().time(), 0.0
        moving = asyncio.ensure_future(call(servo, "moveTo", 1.0))
        while not moving.done():
            await asyncio.sleep(0.02)
            fastest = max(fastest, abs(motor.speed))
        await moving
        assert asyncio.get_running_loop().time() - start == pytest.approx(2.1, abs=0.2)
        assert fastest < 0.56
        assert bench.values["position"] == pytest.approx(1.0, abs=0.02)
        assert motor.angle - start_angle == pytest.approx(direction(drive_mode), abs=0.02)
        await call(servo, "moveTo", -1.0)
        assert motor.angle - start_angle == pytest.approx(-direction(drive_mode), abs=0.02)

    bench.run(scenario)


@pytest.mark.parametrize("drive_mode", DRIVE_MODES)
def test_velocity_and_current_turn_in_the_direction_of_the_mode(drive_mode):
    bench = in_mode(drive_mode, ttl=2.0)
    motor = bench.servos[1].motion.motor

    async def scenario(servo):
        await call(servo, "torque", True)
        for mode, instruction, value in (("velocity", "setVelocity", 1.0), ("current", "setCurrent", 0.3)):
            await call(servo, "mode", mode)
            await call(servo, instruction, value)
            await asyncio.sleep(0.3)
            assert motor.speed * direction(drive_mode) > 0.3
            assert bench.values["velocity"] > 0.3
            await call(servo, "torque", False)
            await asyncio.sleep(0.5)
            await call(servo, "torque", True)

    bench.run(scenario)


@pytest.mark.parametrize("drive_mode", [0, REVERSE])
def test_drive_mode_does_not_change_the_sign_of_the_homing_offset(drive_mode):
    bench = in_mode(drive_mode)

    async def scenario(servo):
        await call(servo, "calibrate", 0.5)
        assert bench.servos[1].table["homing_offset"] == pytest.approx(0.5 * COUNTS, abs=1)
        assert (await servo.servo.present()).position == pytest.approx(0.5, abs=0.002)
        await call(servo, "torque", True)
        await call(servo, "moveTo", 0.0)

    bench.run(scenario)


@pytest.mark.parametrize("drive_mode", [0, REVERSE])
def test_limits_are_in_the_direction_of_the_servo(drive_mode):
    bench = in_mode(drive_mode)
    motor = bench.servos[1].motion.motor
    start_angle = motor.angle

    async def scenario(servo):
        await call(servo, "setRange", 0.0, 1.0)
        await call(servo, "torque", True)
        with pytest.raises(DeviceError, match=r"only moves from 0\.000 to"):
            await call(servo, "moveTo", -0.5)
        await call(servo, "moveTo", 1.0)
        assert (motor.angle - start_angle) * direction(drive_mode) == pytest.approx(1.0, abs=0.02)

    bench.run(scenario)


@pytest.mark.parametrize("drive_mode", [0, REVERSE])
def test_position_after_a_restart_is_within_one_turn(drive_mode):
    bench = in_mode(drive_mode)
    servo = bench.servos[1]
    for angle in (0.0, 0.1, 3.0, 6.2, 7.0, -1.0):
        servo.motion.motor.angle = angle
        servo.reboot()
        position = int.from_bytes(servo.read(132, 4), "little", signed=True)
        assert 0 <= position <= 4096
        assert math.cos(position / COUNTS) == pytest.approx(math.cos(angle), abs=0.01)
        assert math.sin(position / COUNTS) * direction(drive_mode) == pytest.approx(math.sin(angle), abs=0.01)


@pytest.mark.parametrize("drive_mode", [0, REVERSE])
def test_extended_mode_moves_over_one_turn(drive_mode):
    bench = in_mode(drive_mode, limits={"speed": 4.0}, lowest=-100.0, highest=100.0)
    motor = bench.servos[1].motion.motor
    start_angle = motor.angle

    async def scenario(servo):
        await call(servo, "mode", "extended")
        await call(servo, "torque", True)
        await call(servo, "moveTo", 9.0)
        assert motor.angle - start_angle == pytest.approx(9.0 * direction(drive_mode), abs=0.02)

    bench.run(scenario)


@on_bench(in_mode, TIME_BASED, limits={"speed": 0.2}, lowest=-100.0, highest=100.0)
async def test_motion_longer_than_the_longest_profile_is_refused(bench, servo, /):
    await call(servo, "mode", "extended")
    await call(servo, "torque", True)
    with pytest.raises(DeviceError, match=r"takes 35\.0 s for this motion at 0\.2 rad/s"):
        await call(servo, "moveTo", 7.0)
    await call(servo, "moveTo", 1.0)


@on_bench(in_mode, TORQUE_BY_GOAL)
async def test_servo_with_torque_by_goal_keeps_its_torque_off(bench, servo, /):
    await call(servo, "torque", True)
    bench.driver.quiet()
    await asyncio.sleep(1.5)
    bench.driver.resume()
    await bench.until(lambda: any("stopped by its own watchdog" in note for note in bench.notes))
    await call(servo, "torque", False)
    await call(servo, "release")
    await servo.make_safe()
    await asyncio.sleep(1.0)
    assert bench.servos[1].table["torque_enable"] == 0


@pytest.mark.parametrize("drive_mode", [mode for mode in DUAL_DRIVE_MODES if mode & SLAVE])
def test_slave_ignores_goals_and_is_refused(drive_mode):
    bench = in_mode(drive_mode, "XM540-W270")
    servo = bench.servos[1]
    servo.write(64, b"\1")
    servo.write(116, (3000).to_bytes(4, "little"))
    start_angle = servo.motion.motor.angle

    async def scenario(device):
        await call(device, "torque", True)
        with pytest.raises(
            DeviceError, match=r"moveTo refused: servo 1 is a slave \(bit 1 of its drive mode\)"
        ):
            await call(device, "moveTo", 0.5)
        assert servo.motion.motor.angle == start_angle

    bench.run(scenario)


def test_models_without_dual_drive_refuse_the_slave_bit():
    servo = Bench(fake="XM430-W350").servos[1]
    for drive_mode in range(16):
        if drive_mode in DRIVE_MODES:
            servo.write(10, bytes([drive_mode]))
        else:
            with pytest.raises(Exception, match="RANGE"):
                servo.write(10, bytes([drive_mode]))


@pytest.mark.parametrize("drive_mode", [0, TIME_BASED])
def test_rounding_never_exceeds_the_speed_limit(drive_mode):
    for limit in (0.3, 0.5, 1.0, 1.5):
        bench = in_mode(drive_mode, limits={"speed": limit}, ttl=2.0)

        async def scenario(servo, bench=bench, limit=limit):
            await call(servo, "torque", True)
            await call(servo, "setPosition", 0.5)
            profile = bench.servos[1].table["profile_velocity"]
            speed = 0.5 / profile * 1000.0 if drive_mode else profile * servo.servo.model.velocity
            assert 0.9 * limit < speed <= limit * 1.01 if drive_mode else speed <= limit
            await call(servo, "mode", "velocity")
            await call(servo, "setVelocity", -limit)
            goal = bench.servos[1].table["goal_velocity"] * servo.servo.model.velocity
            assert -limit <= goal < -0.9 * limit
            await call(servo, "setVelocity", 0.1 + 0.2 if limit == 0.3 else limit)
            with pytest.raises(DeviceError, match="above the limit"):
                await call(servo, "setVelocity", limit * 1.001)

        bench.run(scenario)


@on_bench(in_mode, 0)
async def test_huge_and_infinite_numbers_are_refused_without_a_limit(bench, servo, /):
    await call(servo, "torque", True)
    for instruction in ("moveTo", "setPosition", "calibrate", "setVelocity", "setCurrent"):
        if mode := {"setVelocity": "velocity", "setCurrent": "current"}.get(instruction):
            await call(servo, "mode", mode)
        for number in (math.inf, -math.inf, math.nan, 1.7e308, -1e300, 1e12):
            with pytest.raises(DeviceError):
                await call(servo, instruction, number)
    for highest in (math.inf, 1.7e308, 1e12):
        with pytest.raises(DeviceError):
            await call(servo, "setRange", 0.0, highest)


@on_bench(in_mode, 0, lowest=-0.3, highest=0.3)
async def test_ends_of_the_range_are_reachable_with_rounding_errors(bench, servo, /):
    await call(servo, "setRange", -math.pi, math.pi)
    await call(servo, "torque", True)
    await call(servo, "moveTo", 0.1 + 0.2)
    await call(servo, "moveTo", -(0.1 + 0.2))
    with pytest.raises(DeviceError, match="outside"):
        await call(servo, "moveTo", 0.3001)
