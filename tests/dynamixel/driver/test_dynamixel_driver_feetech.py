"""STS3215 servos of Feetech with the instructions of DYNAMIXEL servos, and servos that fail in motion."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call

from lfield.errors import DeviceError, DeviceNotSetUp
from lfield_sim.dynamixel.sts_series import signed

SYNC_READ, SYNC_WRITE = 0x82, 0x83


def sts(*ids: int, **more) -> Bench:
    return Bench(*ids, fake="STS3215", protocol=0, waivers=["device_watchdog"], **more)


@on_bench(sts, 4, limits={"speed": 2.0})
async def test_feetech_servo_moves_and_reports_its_values(bench, servo, /):
    assert await servo.open() == "STS3215 4 (firmware 3.10, position mode)"
    await call(servo, "torque", True)
    await call(servo, "setProfile", 2.0, 10.0)
    start = asyncio.get_running_loop().time()
    await call(servo, "moveTo", -1.0)
    assert asyncio.get_running_loop().time() - start == pytest.approx(0.7, abs=0.2), "1 rad at 2 rad/s"
    assert bench.values["position"] == pytest.approx(-1.0, abs=0.02)
    assert (bench.values["voltage"], bench.values["temperature"]) == (pytest.approx(7.4, abs=0.1), 30)
    assert math.isfinite(bench.values["effort"])
    await servo.make_safe()


@on_bench(sts, 1, 2, 3)
async def test_feetech_group_is_read_by_one_packet(bench, group, /):
    await call(group, "torque", True)
    await call(group, "setProfile", 2.0, 10.0)
    since = len(bench.sent)
    await call(group, "moveTo", [0.8, -0.8, 0.2])
    assert bench.values["positions"] == pytest.approx([0.8, -0.8, 0.2], abs=0.02)
    instructions = [packet[4] for _, packet in bench.sent[since:]]
    assert instructions.count(SYNC_WRITE) == 1
    assert instructions.count(SYNC_READ) > 0.8 * len(instructions)


@on_bench(sts, 1, limits={"speed": 3.0})
async def test_feetech_velocity_mode_is_stored(bench, servo, /):
    await call(servo, "mode", "velocity")
    await call(servo, "torque", True)
    for _ in range(5):
        await call(servo, "setVelocity", -1.0)
        await asyncio.sleep(0.1)
    assert bench.values["velocity"] == pytest.approx(-1.0, abs=0.05)
    await servo.make_safe()
    assert bench.servos[1].table["lock"] == 1, "the mode is saved, and the EEPROM is locked again"
    bench.servos[1].reboot()
    assert bench.servos[1].table["operating_mode"] == 1
    with pytest.raises(
        DeviceError, match=r"has no mode 'pwm'; there are: position, velocity, currentPosition"
    ):
        await call(servo, "mode", "pwm")


@on_bench(sts, 1, limits={"current": 0.6})
async def test_feetech_gripper_holds_with_a_limited_force(bench, servo, /):
    bench.fault("obstacle=-0.5")
    await call(servo, "mode", "currentPosition")
    await call(servo, "torque", True)
    await call(servo, "setProfile", 2.0, 10.0)
    await call(servo, "moveUntil", -1.0, 0.4)
    assert bench.servos[1].table["torque_limit"] == 167, "0.4 A of a stall current of 2.4 A"
    await asyncio.sleep(1.0)
    assert bench.values["position"] == pytest.approx(-0.5, abs=0.02)
    assert abs(bench.values["current"]) == pytest.approx(0.4, rel=0.15)
    await servo.make_safe()
    assert abs(bench.values["current"]) == pytest.approx(0.4, rel=0.15), "the safe state keeps the force"
    await call(servo, "moveUntil", 0.0, 0.4)
    await call(servo, "mode", "position")
    assert bench.servos[1].table["torque_limit"] == 1000


@on_bench(sts, 1)
async def test_feetech_calibration_is_stored_as_an_offset(bench, servo, /):
    await call(servo, "calibrate", 0.5)
    await call(servo, "setRange", -1.0, 1.0)
    assert (await servo.servo.present()).position == pytest.approx(0.5, abs=0.01)
    assert signed(bench.servos[1].table["homing_offset"], 1 << 11) == -326
    bench.servos[1].reboot()
    await asyncio.sleep(0.2)
    assert (await servo.servo.present()).position == pytest.approx(0.5, abs=0.01)
    await call(servo, "torque", True)
    with pytest.raises(DeviceError, match=r"only moves from -1.000 to 1.000 rad"):
        await call(servo, "moveTo", 1.2)


@pytest.mark.parametrize("angle", [3.0, -3.0])
@on_bench(sts, 1)
async def test_offset_over_half_a_turn_is_stored_in_the_other_direction(bench, servo, /, angle):
    await call(servo, "torque", True)
    await call(servo, "moveTo", -math.copysign(2.0, angle))
    await call(servo, "calibrate", angle)
    assert abs((await servo.servo.present()).position - angle) < 0.01


@pytest.mark.parametrize(
    ("register", "value", "setting", "right"),
    [
        ("status_return_level", 0, "status_return_level of servo 1", 1),
        ("phase", 0x10, "phase of servo 1", 0x0C),
    ],
)
@on_bench(sts, 1, opened=False)
async def test_wrong_stored_setting_is_refused_and_set_up_writes_it(
    bench, servo, /, register, value, setting, right
):
    bench.servos[1].table.put(register, value)
    with pytest.raises(DeviceNotSetUp, match=f"{setting} is {value} and must be {right}"):
        await servo.open()
    await servo.write_setting(setting, right)
    await servo.open()
    bench.servos[1].reboot()
    await asyncio.sleep(0.2)
    assert bench.servos[1].table[register] == right
    await servo.write_setting(setting, value)
    assert bench.servos[1].table[register] == value


@pytest.mark.parametrize(
    ("instruction", "match"),
    [
        (("reboot",), "does not support reboot"),
        (("setCurrent", 0.1), "requires the mode current"),
        (("moveUntil", 0.1, 0.2), "requires the mode currentPosition"),
        (("mode", "extended"), "has no mode 'extended'"),
    ],
)
@on_bench(sts, 1)
async def test_unsupported_feetech_instruction_is_refused(b, servo, /, instruction, match):
    await call(servo, "torque", True)
    with pytest.raises(DeviceError, match=match):
        await call(servo, *instruction)


@pytest.mark.few(4)
@pytest.mark.parametrize(("fake", "protocol"), [("STS3215", 0), ("XL330-M288", 2)])
@pytest.mark.parametrize(
    ("mode", "instruction"),
    [
        ("velocity", ("setVelocity", 1e12)),
        ("currentPosition", ("moveTo", 1e8)),
        ("currentPosition", ("setPosition", -1e8)),
        ("currentPosition", ("moveUntil", 0.1, 1e9)),
        ("currentPosition", ("moveUntil", 1e7, 0.1)),
    ],
)
@on_bench(Bench, 1, waivers=["device_watchdog"], given="fake protocol")
async def test_values_beyond_the_registers_are_refused(bench, servo, /, fake, protocol, mode, instruction):
    await call(servo, "mode", mode)
    await call(servo, "torque", True)
    with pytest.raises(DeviceError, match=r"cannot be limited|cannot have|only moves from"):
        await call(servo, *instruction)


@on_bench(Bench, 1, fake="STS3215", protocol=0, opened=False)
async def test_feetech_without_the_watchdog_waiver_is_refused(b, servo, /):
    with pytest.raises(DeviceError, match="no watchdog in the device"):
        await servo.open()


@on_bench(Bench, 1, fake="STS3215", protocol=1, opened=False)
async def test_error_for_a_wrong_protocol_names_the_option(b, servo, /):
    with pytest.raises(DeviceError, match=r"known: AX-12A\); check 'protocol' in its binding"):
        await servo.open()


@on_bench(sts, 1, 2, names=["pan", "lift"])
async def test_servo_with_reduced_torque_is_refused_until_switched_on_again(bench, group, /):
    await call(group, "torque", True)
    bench.servos[2].table.put("protection_time", 50)
    bench.fault("overload@2=true")
    with pytest.raises(
        DeviceError, match=r"servo 2 \(lift\) has reduced its torque: overload; torque\(true\)"
    ):
        await call(group, "moveTo", [0.5, 1.0])
    assert any("servo 2 (lift) fault: overload; torque reduced" in note for note in bench.notes)
    bench.fault("overload@2=false")
    with pytest.raises(DeviceError, match=r"moveTo: servo 2 \(lift\) has reduced its torque"):
        await call(group, "moveTo", [0.5, 1.0])
    await call(group, "torque", True)
    await call(group, "moveTo", [0.5, 1.0])
    assert bench.values["positions"] == pytest.approx([0.5, 1.0], abs=0.02)


@pytest.mark.few(3)
@pytest.mark.parametrize(
    ("fake", "protocol", "fault", "match"),
    [
        ("STS3215", 0, "hot@2=true", r"servo 2 has shut down: overheating; torque\(true\) restores it"),
        ("STS3215", 0, "brownout@2=true", r"servo 2 has lost its torque without a fault"),
        ("XL330-M288", 2, "hot@2=true", r"servo 2 has shut down: overheating; reboot\(\) restarts it"),
        ("XL330-M288", 2, "brownout@2=true", r"servo 2 has lost its torque without a fault"),
        ("AX-12A", 1, "hot@2=true", r"servo 2 has shut down: overheating; torque\(true\) restores it"),
        ("AX-12A", 1, "brownout@2=true", r"servo 2 has lost its torque without a fault"),
    ],
)
@on_bench(Bench, 1, 2, waivers=["device_watchdog"], given="fake protocol")
async def test_overheating_or_torque_loss_in_motion_stops_all_servos(
    bench, group, /, fake, protocol, fault, match
):
    await call(group, "torque", True)
    await call(group, "setProfile", 0.2, 0.0)
    motion = asyncio.ensure_future(call(group, "moveTo", [1.5, 1.5]))
    await asyncio.sleep(1.0)
    start = asyncio.get_running_loop().time()
    bench.fault(fault)
    with pytest.raises(DeviceError, match=match) as error:
        await motion
    assert error.value.kind == "DeviceException"
    if "brownout" in fault:
        assert asyncio.get_running_loop().time() - start < 1.0
    stopped_at = bench.values["positions"][0]
    await asyncio.sleep(1.0)
    assert bench.values["positions"][0] == pytest.approx(stopped_at, abs=0.03), (
        "the other servo keeps its position"
    )


@on_bench(Bench, 1)
async def test_watchdog_is_set_again_after_a_supply_dip(bench, servo, /):
    await call(servo, "torque", True)
    bench.fault("brownout=true")
    await bench.until(lambda: any("torque off, restarted" in note for note in bench.notes))
    assert bench.servos[1].table["bus_watchdog"] == 50
