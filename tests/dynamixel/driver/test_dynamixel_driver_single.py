"""One simulated servo in virtual time: instructions, limits, modes, EEPROM, safe states, watchdog."""

from __future__ import annotations

import asyncio
import math

import pytest
from coroutine_tests import on_bench
from dynamixel_bench import Bench, call

from lfield.errors import DeviceError

NAN = math.nan


async def enable(servo, velocity=2.0, acceleration=10.0):
    await call(servo, "torque", True)
    await call(servo, "setProfile", velocity, acceleration)


def refused(bench: Bench, *instruction: object, match: str, prepare=enable) -> None:
    """Check that the instruction raises this error and writes nothing to the servo."""

    async def scenario(servo):
        await prepare(servo)
        sent = len(bench.sent)
        with pytest.raises(DeviceError, match=match):
            await call(servo, *instruction)
        writes = [packet for _, packet in bench.sent[sent:] if packet[7] in (0x03, 0x83)]
        assert writes == []

    bench.run(scenario)


def test_opening_identifies_the_servo_and_sets_its_watchdog():
    bench = Bench(7)

    async def scenario(servo):
        assert await servo.open() == "XL330-M288 7 (firmware 52, position mode)"
        assert bench.servos[7].table["bus_watchdog"] == 50  # in units of 20 ms: twice the time-to-live
        assert not bench.servos[7].table["torque_enable"]

    bench.servos[7].table.put("firmware_version", 52)
    bench.run(scenario, opened=False)


@on_bench(Bench)
async def test_move_to_ends_at_the_goal(bench, servo, /):
    await enable(servo)
    start = asyncio.get_running_loop().time()
    await call(servo, "moveTo", 1.0)
    assert bench.values["position"] == pytest.approx(1.0, abs=0.02)
    assert bench.values["temperature"] == pytest.approx(30.0)
    # 1 rad at 2 rad/s and 10 rad/s2: 0.5 s and a ramp of 0.2 s.
    assert asyncio.get_running_loop().time() - start == pytest.approx(0.7, abs=0.1)


@pytest.mark.parametrize("time_based", [False, True])
def test_every_profile_keeps_the_speed_limit(time_based):
    bench = Bench(limits={"speed": 1.0})
    bench.servos[1].table.put("drive_mode", 4 if time_based else 0)

    async def scenario(servo):
        await call(servo, "torque", True)
        moving = asyncio.ensure_future(call(servo, "moveTo", 1.0))
        fastest = 0.0
        while not moving.done():
            await asyncio.sleep(0.05)
            fastest = max(fastest, bench.values["velocity"])
        await moving
        assert 0.8 < fastest < 1.15

    bench.run(scenario)


@on_bench(Bench)
async def test_servo_setpoint_is_sent_once(bench, servo, /):
    await enable(servo)
    sent = len(bench.sent)
    await call(servo, "setPosition", 0.3)
    await asyncio.sleep(1.0)
    goals = [p for _, p in bench.sent[sent:] if p[7] == 3]
    assert len(goals) == 1
    assert bench.values["position"] == pytest.approx(0.3, abs=0.02)


@on_bench(Bench, limits={"speed": 3.0, "current": 0.5})
async def test_velocity_and_current_require_their_mode(bench, servo, /):
    await enable(servo)
    with pytest.raises(DeviceError, match="setVelocity requires the mode velocity; servo 1 is in position"):
        await call(servo, "setVelocity", 1.0)
    await call(servo, "mode", "velocity")
    assert bench.servos[1].table["operating_mode"] == 1
    assert bench.servos[1].table["torque_enable"] == 1
    await call(servo, "setVelocity", -2.0)
    await asyncio.sleep(0.5)
    assert bench.values["velocity"] == pytest.approx(-2.0, abs=0.1)
    await servo.make_safe()
    assert abs(bench.values["velocity"]) < 0.15
    await call(servo, "mode", "current")
    await call(servo, "setCurrent", 0.2)
    assert bench.servos[1].table["goal_current"] == 200


@pytest.mark.parametrize(
    ("instruction", "match"),
    [
        (("moveTo", NAN), "nan rad is outside"),
        (("moveTo", 2.0), "2 rad is outside -1 to 1.5 rad"),
        (("setPosition", math.inf), "inf rad is outside"),
        (("setProfile", 9.0, 1.0), "9 rad/s is above the limit of 4 rad/s"),
        (("setProfile", -1.0, 1.0), "finite numbers of at least 0"),
        (("setProfile", 1.0, NAN), "finite numbers of at least 0"),
        (("setVelocity", NAN), "requires a finite number, not nan"),
        (("setCurrent", NAN), "nan A is above the limit"),
        (("moveUntil", 0.5, 9.0), "9 A is above the limit of 0.6 A"),
        (("moveUntil", 0.5, 0.3), "requires the mode currentPosition"),
        (("moveUntil", 0.5, -0.3), "a current above 0"),
        (("mode", "sideways"), "has no mode 'sideways'"),
        (("calibrate", NAN), "finite angle"),
        (("setRange", 1.0, -1.0), "a lower and a higher"),
        (("setRange", -9.0, 1.0), "is beyond"),
    ],
)
def test_invalid_value_is_refused_before_a_packet_is_sent(instruction, match):
    bench = Bench(limits={"speed": 4.0, "current": 0.6}, lowest=-1.0, highest=1.5)
    refused(bench, *instruction, match=match)


def test_error_has_the_position_limits_of_the_servo():
    bench = Bench()
    bench.servos[1].table.put("max_position_limit", 2500)
    refused(bench, "moveTo", 1.0, match="only moves from -3.142 to 0.693 rad")


def test_motion_without_torque_is_refused():
    async def nothing(servo):
        pass

    refused(Bench(), "moveTo", 0.1, match=r"torque of servo 1 is off; call torque\(true\)", prepare=nothing)


@on_bench(Bench)
async def test_motion_after_torque_off_is_refused_and_reports_torque_off(bench, servo, /):
    await servo.execute("torque", [True])
    await servo.make_safe("torque_off")
    with pytest.raises(DeviceError, match="torque of servo 1 is off"):
        await servo.execute("setPosition", [0.1])
    assert bench.values["torqueOn"] is False


def test_model_without_current_measurement_is_refused():
    async def nothing(servo):
        pass

    bench = Bench(fake="XL430-W250")
    refused(bench, "moveUntil", 0.1, 0.2, match="a XL430-W250 does not measure its current", prepare=nothing)
    assert math.isnan(bench.values["current"])


@on_bench(Bench)
async def test_obstacle_ends_the_motion_and_sets_the_goal_to_the_position(bench, servo, /):
    await enable(servo)
    bench.fault("stuck=true")
    with pytest.raises(DeviceError, match=r"servo 1 stopped 1\.\d+ rad short"):
        await call(servo, "moveTo", 1.2)
    assert bench.servos[1].table["goal_position"] == pytest.approx(2048, abs=70)


@on_bench(Bench)
async def test_overload_is_reported_and_reboot_clears_it(bench, servo, /):
    await enable(servo)
    bench.fault("overload=true")
    with pytest.raises(DeviceError, match=r"overload|short"):
        await call(servo, "moveTo", 1.2)
    await asyncio.sleep(3.0)
    assert bench.values["fault"] == "overload"
    assert not bench.values["torqueOn"]
    assert [note for note in bench.notes if "overload" in note] == ["servo 1 fault: overload; torque off"]
    with pytest.raises(DeviceError, match=r"has shut down: overload; reboot\(\)"):
        await call(servo, "torque", True)
    bench.fault("overload=false")
    await call(servo, "reboot")
    assert bench.values["fault"] == ""
    assert bench.servos[1].table["bus_watchdog"] == 50
    await enable(servo)
    await call(servo, "moveTo", 0.2)


@on_bench(Bench, limits={"speed": 2.0})
async def test_move_until_stops_at_the_force_and_keeps_it(bench, servo, /):
    await call(servo, "mode", "currentPosition")
    await enable(servo, 1.0)
    moving = asyncio.ensure_future(call(servo, "moveUntil", 1.0, 0.3))
    await asyncio.sleep(0.4)
    bench.servos[1].motion.motor.blocked = True
    await moving
    assert bench.values["position"] < 0.9
    assert abs(bench.values["current"]) >= 0.25
    # The safe state keeps the force; with the present position as the goal, the load would fall.
    await servo.make_safe()
    await asyncio.sleep(1.0)
    assert abs(bench.values["current"]) >= 0.25
    bench.servos[1].motion.motor.blocked = False
    await call(servo, "moveUntil", 0.2, 0.3)
    assert bench.values["position"] == pytest.approx(0.2, abs=0.03)


@on_bench(Bench)
async def test_calibration_is_stored_and_published(bench, servo, /):
    await enable(servo)
    await call(servo, "moveTo", 0.3)
    await call(servo, "calibrate", 0.0)
    await asyncio.sleep(0.2)
    assert bench.values["position"] == pytest.approx(0.0, abs=0.01)
    assert bench.values["torqueOn"]
    await asyncio.sleep(0.5)
    assert bench.values["position"] == pytest.approx(0.0, abs=0.01)


@on_bench(Bench)
async def test_range_is_written_with_torque_off_and_torque_is_restored(bench, servo, /):
    await enable(servo)
    await call(servo, "setRange", -0.5, 0.5)
    table = bench.servos[1].table
    assert (table["min_position_limit"], table["max_position_limit"]) == (1722, 2374)
    assert table["torque_enable"] == 1
    with pytest.raises(DeviceError, match=r"only moves from -0\.500 to 0\.500"):
        await call(servo, "moveTo", 0.6)


@on_bench(Bench)
async def test_torque_hold_stops_at_the_present_position(bench, servo, /):
    await enable(servo)
    moving = asyncio.ensure_future(call(servo, "moveTo", 1.5))
    await asyncio.sleep(0.4)
    moving.cancel()
    await servo.make_safe()
    stopped = bench.servos[1].table["goal_position"]
    await asyncio.sleep(1.0)
    assert bench.values["velocity"] == pytest.approx(0.0, abs=0.03)
    assert bench.values["position"] == pytest.approx((stopped - 2048) * 2 * math.pi / 4096, abs=0.02)
    assert bench.values["position"] < 1.2
    assert bench.values["torqueOn"]


@on_bench(Bench)
async def test_stop_ends_the_motion_and_accepts_the_next_goal(bench, servo, /):
    await enable(servo)
    moving = asyncio.ensure_future(call(servo, "moveTo", 1.5))
    await asyncio.sleep(0.4)
    moving.cancel()
    await call(servo, "stop")
    assert bench.values["velocity"] == pytest.approx(0.0, abs=0.03)
    stopped_at = bench.values["position"]
    assert 0.2 < stopped_at < 1.2
    await asyncio.sleep(1.0)
    assert bench.values["position"] == pytest.approx(stopped_at, abs=0.02)
    await call(servo, "moveTo", 0.0)


@on_bench(Bench)
async def test_stop_does_not_switch_the_torque_on(bench, servo, /):
    await call(servo, "stop")
    assert bench.servos[1].table["torque_enable"] == 0


@pytest.mark.parametrize("delay", [0.0, 0.001, 0.002, 0.003, 0.004, 0.005])
@on_bench(Bench, safe_state="torque_off")
async def test_cancelled_mode_change_ends_with_torque_off(bench, servo, /, delay):
    await enable(servo)
    changing = asyncio.ensure_future(call(servo, "mode", "velocity"))
    await asyncio.sleep(delay)
    changing.cancel()
    await servo.make_safe()
    await asyncio.sleep(1.0)
    assert bench.servos[1].table["torque_enable"] == 0


@on_bench(Bench, safe_state="torque_off")
async def test_torque_off_is_confirmed(bench, servo, /):
    await enable(servo)
    await servo.make_safe()
    assert bench.servos[1].table["torque_enable"] == 0


@on_bench(Bench, safe_state="torque_off")
async def test_unconfirmed_servo_safe_state_is_an_error(bench, servo, /):
    await enable(servo)
    bench.fault("dead=true")
    with pytest.raises(DeviceError, match="servo 1 does not answer") as error:
        await servo.make_safe()
    assert error.value.kind == "DeviceTimeoutException"
    bench.fault("dead=false")
    await servo.make_safe()


@on_bench(Bench)
async def test_watchdog_fires_without_packets_and_only_release_clears_it(bench, servo, /):
    await enable(servo)
    await call(servo, "setProfile", 0.5, 0.0)
    moving = asyncio.ensure_future(call(servo, "moveTo", 1.5))
    await asyncio.sleep(0.3)
    moving.cancel()
    bench.driver.quiet()
    last = len(bench.sent)
    await asyncio.sleep(3.0)
    assert len(bench.sent) <= last + 2
    bench.chain.advance(asyncio.get_running_loop().time())
    assert bench.servos[1].table["bus_watchdog"] == 255
    await servo.make_safe()  # a servo stopped by its watchdog is safe
    bench.driver.resume()
    await asyncio.sleep(1.0)
    assert "servo 1 stopped by its own watchdog; release() frees it" in bench.notes
    with pytest.raises(DeviceError, match=r"stopped by its own watchdog; call release\(\)"):
        await call(servo, "moveTo", 0.0)
    stopped_position = bench.values["position"]
    await call(servo, "release")
    await asyncio.sleep(1.0)
    assert bench.values["position"] == pytest.approx(stopped_position, abs=0.02)
    assert bench.servos[1].table["bus_watchdog"] == 50
    await call(servo, "moveTo", 0.0)


@on_bench(Bench, ttl=0.04)
async def test_short_ttl_is_polled_faster_than_the_watchdog(bench, servo, /):
    await enable(servo)
    await asyncio.sleep(2.0)
    assert bench.servos[1].table["bus_watchdog"] == 4
    await call(servo, "moveTo", 0.3)


def test_watchdog_slower_than_the_ttl_requires_a_waiver():
    with pytest.raises(DeviceError, match=r"watchdog too slow: 0\.02 s"):
        Bench(ttl=0.005).run(lambda servo: servo.open(), opened=False)
    Bench(ttl=0.005, waivers=["device_watchdog"]).run(lambda servo: servo.open(), opened=False)


def test_status_return_level_is_set_at_opening():
    bench = Bench()
    bench.servos[1].table.put("status_return_level", 0)
    bench.run(lambda servo: call(servo, "torque", True))
    assert bench.servos[1].table["status_return_level"] == 2


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"model": "XM430-W350"}, "is a XL330-M288, but its binding says"),
        ({"id": 9}, "servo 9 does not answer: check"),
    ],
)
def test_wrong_model_or_absent_servo_is_refused(options, match):
    async def scenario(servo):
        with pytest.raises(DeviceError, match=match):
            await servo.open()

    Bench(**options).run(scenario, opened=False)


@on_bench(Bench, opened=False)
async def test_error_has_the_unknown_model_number(bench, servo, /):
    bench.servos[1].table.put("model_number", 4711)
    with pytest.raises(DeviceError, match="model number 4711, which is not in the tables"):
        await servo.open()
