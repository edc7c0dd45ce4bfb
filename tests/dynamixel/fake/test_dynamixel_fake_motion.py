"""Motion, temperature and protection of simulated servos, with a clock of the test."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from lfield_sim.dynamixel.ax_series import make_servo
from lfield_sim.dynamixel.control_table import InstructionRefused
from lfield_sim.dynamixel.motion_profile import (
    RECTANGULAR,
    STEP,
    TRAPEZOIDAL,
    TRIANGULAR,
    MotionProfile,
    timed,
)
from lfield_sim.dynamixel.servo_model import MODELS, model_named
from lfield_sim.dynamixel.servo_motion import ACCELERATION_UNIT, COUNTS, VELOCITY_UNIT


class Bench:
    """One servo and the present time. An index is the name of a register."""

    def __init__(self, model: str = "XM430-W350", **settings: int) -> None:
        self.servo = make_servo(model_named(model))
        self.now = 0.0
        for name, value in settings.items():
            self[name] = value

    def __setitem__(self, name: str, value: int) -> None:
        item = self.servo.model.items[name]
        raw = (value % (1 << 8 * item.size)).to_bytes(item.size, "little")
        self.servo.write(item.address, raw)

    def __getitem__(self, name: str) -> int:
        item = self.servo.model.items[name]
        raw = self.servo.read(item.address, item.size)
        return int.from_bytes(raw, "little", signed=item.signed)

    def wait(self, seconds: float, *, traffic: bool = True) -> Bench:
        """Advance the time. `traffic`: there are packets on the bus."""
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now = min(end, self.now + 0.02)
            self.servo.advance(self.now)
            if traffic:
                self.servo.on_packet(self.now)
        return self


# ---- profiles ---------------------------------------------------------------------------------------

places = st.floats(-1e5, 1e5)
speeds = st.floats(1.0, 1e5)


@given(places, st.floats(-1e4, 1e4), places, speeds, speeds)
def test_profile_reaches_its_goal_within_its_bounds(start, speed, goal, fastest, acceleration):
    profile = MotionProfile(start, speed, goal, fastest, acceleration)
    assert profile.at(profile.duration + 1.0) == (goal, 0.0)
    most, before, last = max(fastest, abs(speed)), speed, 0.0
    for number in range(201):
        time = profile.duration * number / 200.0
        place, now = profile.at(time)
        assert abs(now) <= most * 1.001 + 1e-6
        assert abs(now - before) <= acceleration * (time - last) * 1.001 + most * 1e-6 + 1e-6
        before, last = now, time
    # The position is continuous at the end of the profile.
    place, now = profile.at(max(0.0, profile.duration * (1 - 1e-9)))
    assert place == pytest.approx(
        goal, abs=1e-3 + 1e-6 * abs(goal - start) + 1e-6 * speed * speed / acceleration
    )


@given(places, places, st.floats(0.01, 30.0), st.floats(0.0, 30.0))
def test_timed_profile_has_the_given_duration(start, goal, total, rising):
    assume(abs(goal - start) > 1.0)
    profile = MotionProfile(start, 0.0, goal, *timed(goal - start, total, rising))
    assert profile.duration == pytest.approx(total, rel=1e-6)


def test_profile_kind_depends_on_speed_and_acceleration():
    assert MotionProfile(0, 0, 100, math.inf, 10.0).kind == STEP
    assert MotionProfile(0, 0, 100, 10.0, math.inf).kind == RECTANGULAR
    assert MotionProfile(0, 0, 100, 10.0, 10.0).kind == TRAPEZOIDAL
    assert MotionProfile(0, 0, 100, 1000.0, 10.0).kind == TRIANGULAR


# ---- operating modes --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", sorted(name for name, model in MODELS.items() if model.protocol == 2))
def test_every_model_reaches_its_goal_and_rests(model):
    bench = Bench(model, torque_enable=1, goal_position=3000).wait(4.0)
    assert abs(bench["present_position"] - 3000) <= 1
    assert (bench["moving"], bench["present_velocity"], bench["hardware_error_status"]) == (0, 0, 0)
    assert bench["moving_status"] & 1
    assert bench.servo.motion.resting


def test_trapezoidal_profile_over_time():
    bench = Bench(torque_enable=1, profile_velocity=100, profile_acceleration=20, goal_position=3000)
    speed, acceleration = 100 * VELOCITY_UNIT * COUNTS, 20 * ACCELERATION_UNIT * COUNTS
    length = (3000 - 2048) / speed + speed / acceleration
    samples = []
    while bench.now < length - 0.02:
        bench.wait(0.02)
        samples.append((bench["present_velocity"], bench["velocity_trajectory"], bench["moving"]))
    assert max(v for v, _, _ in samples) == pytest.approx(100, abs=2)
    assert all(abs(v - expected) <= 3 for v, expected, _ in samples)
    assert all(moving for _, _, moving in samples)
    assert bench["moving_status"] & 0x32 == 0x32
    bench.wait(0.2)
    assert (bench["present_position"], bench["moving"]) == (3000, 0)


def test_time_based_profile_has_the_given_duration():
    bench = Bench(drive_mode=4, torque_enable=1, profile_velocity=2000, profile_acceleration=500)
    bench["goal_position"] = 3000
    assert bench.wait(1.0)["present_position"] == pytest.approx(2524, abs=5), (
        "half of the distance at half of the time"
    )
    assert bench.wait(0.9)["moving"] == 1
    assert bench.wait(0.2)["moving"] == 0


def test_velocity_mode_with_ramp_over_several_turns():
    bench = Bench(operating_mode=1, torque_enable=1, profile_acceleration=10, goal_velocity=100)
    half = 100 * VELOCITY_UNIT / (10 * ACCELERATION_UNIT) / 2
    assert bench.wait(half)["present_velocity"] == pytest.approx(50, abs=3)
    assert bench.wait(5.0)["present_velocity"] == pytest.approx(100, abs=1)
    assert bench["present_position"] > 5000
    bench["goal_velocity"] = -100
    assert bench.wait(3.0)["present_velocity"] == pytest.approx(-100, abs=1)


def test_extended_mode_counts_turns_and_position_mode_does_not():
    bench = Bench(operating_mode=4, torque_enable=1, goal_position=10_000).wait(4.0)
    assert bench["present_position"] == 10_000
    bench["torque_enable"] = 0
    bench["operating_mode"] = 3
    assert bench["present_position"] == 10_000 % 4096


def test_current_and_pwm_modes_apply_their_goals():
    bench = Bench(operating_mode=0, torque_enable=1, goal_current=50).wait(0.04)
    assert bench["present_current"] == pytest.approx(50, abs=2)
    bench = Bench(operating_mode=16, torque_enable=1, goal_pwm=-442).wait(2.0)
    assert bench["present_velocity"] == pytest.approx(-100, rel=0.05), "half of the maximum velocity"
    assert bench["present_pwm"] == pytest.approx(-442, abs=10)


def test_current_based_position_holds_with_its_goal_current():
    bench = Bench(operating_mode=5, torque_enable=1, goal_current=100)
    bench.servo.motion.motor.blocked = True
    bench["goal_position"] = 4000
    bench.wait(3.0)
    assert bench["present_current"] == pytest.approx(100, abs=1)
    assert bench["hardware_error_status"] == 0, "a limited current is no overload"
    assert bench["moving_status"] & 0x09 == 0x08


def test_servo_stops_at_an_obstacle_and_can_return():
    bench = Bench(operating_mode=5)
    bench["torque_enable"], bench["goal_current"] = 1, 100
    bench.servo.motion.motor.set_obstacle(math.pi + 0.3)
    bench["goal_position"] = 2048 + round(0.6 * COUNTS)
    bench.wait(1.0)
    assert bench["present_position"] == pytest.approx(2048 + 0.3 * COUNTS, abs=2)
    assert abs(bench["present_current"]) > 80
    bench["goal_position"] = 2048
    bench.wait(4.0)
    assert bench["present_position"] == pytest.approx(2048, abs=3)


def test_drive_mode_reverses_motion_and_homing_offset_shifts_positions():
    bench = Bench(drive_mode=1, operating_mode=1, torque_enable=1, goal_velocity=50)
    before = bench["present_position"]
    bench.wait(1.0)
    assert bench["present_velocity"] == pytest.approx(50, abs=1)
    assert bench["present_position"] > before
    assert bench.servo.motion.motor.speed < 0
    bench = Bench(homing_offset=500)
    assert bench["present_position"] == 2548
    bench["homing_offset"] = 2000
    assert bench["present_position"] == 2048, "position mode ignores offsets beyond 1024"


def test_torque_on_resets_the_goal_to_the_present_position():
    bench = Bench(torque_enable=1, goal_position=3000).wait(3.0)
    bench["torque_enable"] = 0
    bench["goal_position"] = 1000
    bench["torque_enable"] = 1
    assert bench.wait(1.0)["present_position"] == 3000
    assert bench["goal_position"] == 3000


def test_goal_switches_the_torque_on_in_its_drive_mode():
    bench = Bench(drive_mode=8, goal_position=2500)
    assert bench["torque_enable"] == 1
    assert bench.wait(2.0)["present_position"] == 2500
    bench["torque_enable"] = 0
    bench["goal_position"] = 1000
    assert bench.wait(2.0)["present_position"] == 1000


# ---- protection -------------------------------------------------------------------------------------


def test_overload_shuts_down_until_reboot():
    bench = Bench(torque_enable=1)
    motor = bench.servo.motion.motor
    motor.blocked, motor.load, bench.servo.motion.resting = True, 6.0, False
    bench.wait(0.5)
    assert (bench["torque_enable"], bench["hardware_error_status"]) == (1, 0)
    assert abs(bench["present_current"]) > 600
    bench.wait(1.0)
    assert (bench["torque_enable"], bench["hardware_error_status"]) == (0, 0x20)
    bench["torque_enable"] = 1
    assert bench["torque_enable"] == 0
    motor.blocked, motor.load = False, 0.0
    bench.servo.reboot()
    bench.wait(0.2)
    bench["torque_enable"] = 1
    assert (bench["torque_enable"], bench["hardware_error_status"]) == (1, 0)


@pytest.mark.parametrize(
    ("apply_fault", "bit"),
    [
        (lambda servo: setattr(servo.motion.motor, "heater", 10.0), 0x04),
        (lambda servo: setattr(servo.motion.motor, "sag", 4.0), 0x01),
        (lambda servo: setattr(servo, "encoder_fault", True), 0x08),
    ],
)
def test_error_is_reported_and_shutdown_selects_torque_off(apply_fault, bit):
    for shutdown in (0, bit):
        bench = Bench(shutdown=shutdown, torque_enable=1)
        apply_fault(bench.servo)
        bench.wait(8.0)
        assert bench["hardware_error_status"] == bit
        assert bench["torque_enable"] == (0 if shutdown else 1)


def test_load_heats_the_servo_and_lowers_the_voltage():
    bench = Bench(operating_mode=16, torque_enable=1)
    cold, idle = bench["present_temperature"], bench["present_input_voltage"]
    assert (cold, idle) == (30, 120)
    bench.servo.motion.motor.blocked = True
    bench["goal_pwm"] = 400
    bench.wait(30.0)
    assert bench["present_temperature"] > cold
    assert bench["present_input_voltage"] < idle


def test_bus_watchdog_stops_the_servo_and_locks_goals():
    bench = Bench(operating_mode=1, torque_enable=1, bus_watchdog=10, goal_velocity=100)
    assert bench.wait(1.0)["present_velocity"] > 90, "with traffic on the bus"
    assert bench.wait(0.18, traffic=False)["bus_watchdog"] == 10
    bench.wait(0.5, traffic=False)
    assert (bench["bus_watchdog"], bench["present_velocity"], bench["torque_enable"]) == (255, 0, 1)
    for name, value in (("goal_velocity", 50), ("bus_watchdog", 10)):
        with pytest.raises(InstructionRefused, match="RANGE"):
            bench[name] = value
    bench["bus_watchdog"] = 0
    bench["goal_velocity"] = 50
    assert bench.wait(0.5)["present_velocity"] == pytest.approx(50, abs=1)


def test_watchdog_is_inactive_while_torque_is_off():
    bench = Bench(bus_watchdog=1)
    assert bench.wait(1.0, traffic=False)["bus_watchdog"] == 1


def test_realtime_tick_counts_milliseconds_and_wraps():
    bench = Bench()
    assert bench.wait(2.0)["realtime_tick"] == pytest.approx(2000, abs=2)
    assert bench.wait(32.0)["realtime_tick"] == pytest.approx(34_000 - 32_768, abs=3)


def test_startup_configuration_restores_the_torque_after_reboot():
    bench = Bench(startup_configuration=1)
    bench.servo.reboot()
    assert not bench.servo.awake
    assert bench.wait(0.2).servo.awake
    assert bench["torque_enable"] == 1


# ---- AX-12A ---------------------------------------------------------------------------------------------


def test_ax_goal_switches_the_torque_on_and_moves_at_its_speed():
    bench = Bench("AX-12A", moving_speed=100, goal_position=800)
    assert bench["torque_enable"] == 1, "a goal switches the torque on"
    bench.wait(1.0)
    assert (bench["moving"], bench["present_speed"]) == (1, pytest.approx(100, abs=2))
    assert bench.wait(2.0)["present_position"] == 800
    assert bench["moving"] == 0
    bench["goal_position"] = 200
    assert bench.wait(0.5)["present_speed"] == pytest.approx(1024 + 100, abs=2), "clockwise"


def test_ax_wheel_mode_turns_without_an_end():
    bench = Bench("AX-12A", ccw_angle_limit=0, torque_enable=1, moving_speed=1024 + 512).wait(1.0)
    assert bench["present_speed"] == pytest.approx(1024 + 512 * 59 / 0.111 / 1023, rel=0.05)
    assert bench.wait(3.0)["moving"] == 1


def test_ax_refuses_goals_beyond_its_angles_and_locked_registers():
    bench = Bench("AX-12A", cw_angle_limit=300, lock=1)
    for name, value, reason in (("goal_position", 200, "LIMIT"), ("id", 5, "ACCESS"), ("lock", 0, "RANGE")):
        with pytest.raises(InstructionRefused, match=reason):
            bench[name] = value


def test_overloaded_ax_is_restored_by_its_torque_limit():
    bench = Bench("AX-12A", torque_enable=1)
    motor = bench.servo.motion.motor
    motor.blocked, motor.load, bench.servo.motion.resting = True, 3.0, False
    bench.wait(1.1)
    assert (bench["torque_enable"], bench["torque_limit"]) == (0, 0)
    motor.blocked, motor.load = False, 0.0
    bench["torque_limit"] = 1023
    bench["goal_position"] = 600
    assert bench.wait(2.0)["present_position"] == 600
    assert bench.servo.alert == 0


@given(
    st.sampled_from(["XM430-W350", "AX-12A"]),
    st.lists(st.tuples(st.integers(0, 200), st.integers(-(1 << 31), 1 << 31)), max_size=12),
)
def test_servo_is_readable_after_any_writes(model, writes):
    bench = Bench(model)
    names = sorted(bench.servo.model.items)
    for number, value in writes:
        with contextlib.suppress(InstructionRefused):
            bench[names[number % len(names)]] = value
        bench.wait(0.06)
    assert len(bench.servo.read(0, 50)) == 50
