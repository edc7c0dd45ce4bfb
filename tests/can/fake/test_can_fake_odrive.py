"""An ODrive axis by frames on the time of the test."""

from __future__ import annotations

import math
import struct

import pytest
from can_fake_bench import Bench

from lfield_sim.can.odrive.cansimple_table import (
    AxisError,
    AxisState,
    ControlMode,
    InputMode,
    ProcedureResult,
)


class OdriveBench(Bench):
    """One axis, node 3."""

    def __init__(self, options: str = "") -> None:
        super().__init__(f"odrive:3{options}")
        self.axis = self.devices[0].axis

    def command(self, number: int, layout: str = "<", *values: float) -> None:
        self.send(3 << 5 | number, struct.pack(layout, *values))
        self.wait()

    def ask(self, number: int, layout: str) -> tuple:
        self.send(3 << 5 | number, remote=True)
        self.wait(0.01)
        return struct.unpack(layout, self.last(3 << 5 | number))

    def closed_loop(self, control: ControlMode, mode: InputMode = InputMode.PASSTHROUGH) -> None:
        self.command(0x0B, "<II", control, mode)
        self.command(0x07, "<I", AxisState.CLOSED_LOOP_CONTROL)

    @property
    def beat(self) -> tuple[int, int, int, int]:
        """Errors, state, result, and whether the trajectory is done."""
        self.wait(0.11)
        return struct.unpack("<IBBBx", self.last(0x61))


@pytest.fixture
def bench() -> OdriveBench:
    return OdriveBench()


def test_periodic_messages_and_their_rates(bench):
    received = [frame.identifier for frame in bench.wait(1.0)]
    counts = {number: received.count(3 << 5 | number) for number in (0x01, 0x09, 0x03, 0x14, 0x15, 0x17)}
    assert counts == pytest.approx({0x01: 10, 0x09: 100, 0x03: 10, 0x14: 10, 0x15: 2, 0x17: 2}, abs=1)
    assert bench.beat == (0, AxisState.IDLE, ProcedureResult.SUCCESS, 1)


def test_requests_are_remote_frames_or_empty_frames(bench):
    assert bench.ask(0x00, "<8B")[4:7] == (0, 6, 9)
    bench.send(0x7C)
    bench.wait(0.01)
    assert struct.unpack("<ff", bench.last(0x7C)) == (0.0, 0.0)
    voltage, current = bench.ask(0x17, "<ff")
    assert (voltage, current) == (pytest.approx(48.0), 0.0)
    assert bench.ask(0x15, "<ff") == (20.0, 25.0)


def test_axis_does_not_move_before_closed_loop(bench):
    bench.command(0x0B, "<II", ControlMode.VELOCITY, InputMode.PASSTHROUGH)
    bench.command(0x0D, "<ff", 2.0, 0.0)
    bench.wait(0.5)
    assert bench.axis.position == 0.0
    bench.command(0x07, "<I", AxisState.CLOSED_LOOP_CONTROL)
    bench.wait(0.5)
    assert bench.axis.velocity == 0.0, "the inputs are reset on entering closed loop"


def test_velocity_follows_limits_and_ramp(bench):
    bench.closed_loop(ControlMode.VELOCITY)
    bench.command(0x0D, "<ff", 3.0, 0.0)
    bench.wait(0.5)
    assert bench.ask(0x09, "<ff")[1] == pytest.approx(3.0)
    bench.command(0x0F, "<ff", 5.0, 10.0)
    bench.command(0x0D, "<ff", 100.0, 0.0)
    bench.wait(0.5)
    assert bench.axis.velocity == pytest.approx(5.0)
    bench.command(0x0B, "<II", ControlMode.VELOCITY, InputMode.VEL_RAMP)
    bench.command(0x0D, "<ff", 0.0, 0.0)
    bench.wait(0.1)
    assert bench.axis.velocity == pytest.approx(4.0, abs=0.15), "10 turns per second squared"


def test_position_follows_a_trajectory(bench):
    bench.closed_loop(ControlMode.POSITION, InputMode.TRAP_TRAJ)
    bench.command(0x11, "<f", 2.0)
    bench.command(0x12, "<ff", 4.0, 4.0)
    bench.command(0x0C, "<fhh", 3.0, 0, 0)
    assert bench.beat[3] == 0
    bench.wait(0.9)
    assert bench.axis.velocity == pytest.approx(2.0, abs=0.05)
    bench.wait(1.5)
    assert bench.axis.position == pytest.approx(3.0, abs=0.01)
    assert bench.beat == (0, AxisState.CLOSED_LOOP_CONTROL, ProcedureResult.SUCCESS, 1)


def test_direct_position_is_bounded_by_the_speed_limit(bench):
    bench.command(0x0F, "<ff", 4.0, 10.0)
    bench.closed_loop(ControlMode.POSITION)
    bench.command(0x0C, "<fhh", 2.0, 0, 0)
    bench.wait(0.2)
    assert bench.axis.velocity == pytest.approx(4.0, abs=0.05)
    bench.wait(1.0)
    assert bench.axis.position == pytest.approx(2.0, abs=0.001)


def test_torque_accelerates_the_axis(bench):
    bench.closed_loop(ControlMode.TORQUE)
    bench.command(0x0E, "<f", 0.1)
    bench.wait(0.5)
    assert bench.axis.velocity == pytest.approx(0.1 / 0.01 * 0.5 / math.tau, abs=0.05)
    assert bench.ask(0x14, "<ff")[1] == pytest.approx(0.5)
    assert bench.ask(0x1C, "<ff")[1] == pytest.approx(0.1)


def test_speed_limit_below_the_speed_disarms(bench):
    bench.closed_loop(ControlMode.VELOCITY)
    bench.command(0x0D, "<ff", 10.0, 0.0)
    bench.wait(0.5)
    bench.command(0x0F, "<ff", 2.0, 10.0)
    errors, state, result, _ = bench.beat
    assert (errors, state, result) == (
        AxisError.VELOCITY_LIMIT_VIOLATION,
        AxisState.IDLE,
        ProcedureResult.DISARMED,
    )


def test_estop_and_errors_must_be_cleared(bench):
    bench.closed_loop(ControlMode.VELOCITY)
    bench.command(0x0D, "<ff", 2.0, 0.0)
    bench.wait(0.3)
    bench.command(0x02)
    assert bench.beat[:3] == (AxisError.ESTOP_REQUESTED, AxisState.IDLE, ProcedureResult.DISARMED)
    assert bench.ask(0x03, "<II") == (AxisError.ESTOP_REQUESTED, AxisError.ESTOP_REQUESTED)
    bench.command(0x07, "<I", AxisState.CLOSED_LOOP_CONTROL)
    assert bench.beat[1:3] == (AxisState.IDLE, ProcedureResult.DISARMED)
    bench.command(0x18, "<B", 0)
    bench.command(0x07, "<I", AxisState.CLOSED_LOOP_CONTROL)
    assert bench.beat[:3] == (0, AxisState.CLOSED_LOOP_CONTROL, ProcedureResult.SUCCESS)


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        ("overcurrent", AxisError.CURRENT_LIMIT_VIOLATION),
        ("overheat", AxisError.MOTOR_OVER_TEMP),
        ("follow_error", AxisError.SPINOUT_DETECTED),
        ("stuck", AxisError.SPINOUT_DETECTED),
    ],
)
def test_fault_disarms_the_axis(bench, fault, error):
    bench.closed_loop(ControlMode.VELOCITY)
    bench.command(0x0D, "<ff", 2.0, 0.0)
    bench.fault(f"{fault}@3=true")
    bench.wait(1.0)
    assert bench.beat[:2] == (error, AxisState.IDLE)
    bench.fault(f"{fault}@3=false")
    bench.command(0x18, "<B", 0)
    assert bench.beat[0] == 0


def test_homing_and_calibration_take_time_and_end_idle(bench):
    bench.command(0x07, "<I", AxisState.HOMING)
    assert bench.beat[1:3] == (AxisState.HOMING, ProcedureResult.BUSY)
    bench.wait(2.0)
    assert bench.beat[1:3] == (AxisState.IDLE, ProcedureResult.SUCCESS)
    assert bench.axis.position == pytest.approx(0.0, abs=0.01)
    assert bench.devices[0].motor.angle < -3.0
    bench.command(0x07, "<I", AxisState.FULL_CALIBRATION)
    assert bench.beat[2] == ProcedureResult.BUSY
    bench.command(0x07, "<I", AxisState.IDLE)
    assert bench.beat[1:3] == (AxisState.IDLE, ProcedureResult.CANCELLED)


@pytest.mark.parametrize("rest", [b"", bytes(4)])
def test_parameter_is_read_with_four_or_eight_bytes(bench, rest):
    """ODrive's own examples send `struct.pack("<BHB", 0, endpoint, 0)`, its DBC file a frame of 8 bytes."""
    bench.command(0x04, "<BHB", 0, 3, 0) if not rest else bench.command(0x04, "<BHB4s", 0, 3, 0, rest)
    bench.wait(0.01)
    assert struct.unpack("<BHBf", bench.last(0x65)) == (0, 3, 0, 10.0)


def test_write_without_a_value_changes_nothing(bench):
    bench.command(0x04, "<BHB", 1, 3, 0)
    bench.wait(0.01)
    assert bench.axis.ramp_rate == 10.0


def test_watchdog_parameters_disarm_the_axis_without_commands(bench):
    bench.command(0x04, "<BHB?3x", 1, 1, 0, True)
    bench.command(0x04, "<BHBf", 1, 2, 0, 0.25)
    bench.command(0x04, "<BHB4x", 0, 2, 0)
    bench.wait(0.01)
    assert struct.unpack("<BHBf", bench.last(0x65)) == (0, 2, 0, 0.25)
    bench.closed_loop(ControlMode.VELOCITY)
    for _ in range(10):
        bench.command(0x0D, "<ff", 1.0, 0.0)
        bench.wait(0.1)
    assert bench.beat[1] == AxisState.CLOSED_LOOP_CONTROL
    bench.wait(0.3)
    assert bench.beat[:2] == (AxisError.WATCHDOG_TIMER_EXPIRED, AxisState.IDLE)


def test_reading_does_not_feed_the_watchdog():
    bench = OdriveBench(",watchdog=0.25")
    bench.closed_loop(ControlMode.VELOCITY)
    for _ in range(10):
        bench.ask(0x09, "<ff")
        bench.wait(0.05)
    assert bench.beat[0] == AxisError.WATCHDOG_TIMER_EXPIRED


def test_load_moves_an_idle_axis_without_brake():
    bench = OdriveBench(",load=0.2")
    bench.wait(0.3)
    assert bench.axis.position < -0.1
    bench.command(0x19, "<f", 0.0)
    bench.closed_loop(ControlMode.POSITION)
    bench.wait(0.5)
    assert abs(bench.axis.velocity) < 0.01
    assert bench.devices[0].motor.torque == pytest.approx(0.2, abs=0.01)


def test_reboot_and_power_loss_end_idle(bench):
    bench.closed_loop(ControlMode.VELOCITY)
    bench.command(0x16, "<B", 0)
    assert bench.beat[1] == AxisState.IDLE
    bench.closed_loop(ControlMode.VELOCITY)
    bench.fault("silence@3=true")
    assert bench.wait(0.5)[1:] == []
    bench.fault("silence@3=false")
    assert bench.beat[1] == AxisState.IDLE


def test_nan_and_short_frames_are_ignored(bench):
    bench.closed_loop(ControlMode.VELOCITY)
    bench.command(0x0D, "<ff", float("nan"), 0.0)
    bench.command(0x0D, "<f", 5.0)
    bench.command(0x07, "<I", 77)
    bench.wait(0.2)
    assert bench.axis.velocity == 0.0
    assert bench.beat[1] == AxisState.CLOSED_LOOP_CONTROL


def test_nonsense_and_lost_messages_faults(bench):
    bench.fault("lost_tpdo@3=true")
    bench.wait(0.02)
    assert {frame.identifier for frame in bench.wait(1.0)} == {0x61}
    bench.fault("nonsense@3=1")
    assert bench.ask(0x00, "<8B")[4:7] != (0, 6, 9)
