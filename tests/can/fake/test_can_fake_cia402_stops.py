"""Stops and faults of a CiA 402 drive, by frames on the time of the test."""

from __future__ import annotations

import struct

import pytest
from can_fake_bench import DriveBench, go_to, state

from lfield_sim.can.cia402.cia402_table import INCREMENTS, PP, PT, PV

ENABLED, QUICK_STOP, FAULT, DISABLED = 0x27, 0x07, 0x08, 0x40


def turning(options: str = "", **codes: int) -> DriveBench:
    """A drive at ten turns a second, with option codes by their index: `x605A=0`."""
    bench = DriveBench(options)
    bench.wait(0.1)
    bench.write(0x6085, 25 * INCREMENTS)
    for name, code in codes.items():
        assert bench.write(int(name[1:], 16), code) == 0
    bench.enable(PV)
    bench.write(0x60FF, 10 * INCREMENTS)
    bench.wait(2.0)
    return bench


#: Turns per second that are left of ten, 0.1 s after the torque was released, or with each ramp.
RUNS_OUT, SLOWLY, QUICKLY, HARD = 9.8, 9.0, 7.5, 4.8


@pytest.mark.parametrize(
    ("option", "left", "end"),
    [
        (0, RUNS_OUT, DISABLED),
        (1, SLOWLY, DISABLED),
        (2, QUICKLY, DISABLED),
        (3, HARD, DISABLED),
        (4, HARD, DISABLED),
        (5, SLOWLY, QUICK_STOP),
        (6, QUICKLY, QUICK_STOP),
        (7, HARD, QUICK_STOP),
        (8, HARD, QUICK_STOP),
    ],
)
def test_quick_stop_follows_its_option_code(option, left, end):
    bench = turning(x605A=option)
    bench.write(0x6040, 0x0B)
    bench.wait(0.1)
    assert bench.read(0x606C) / INCREMENTS == pytest.approx(left, abs=0.15)
    assert state(bench) == (QUICK_STOP if option else DISABLED)
    bench.wait(1.2)
    assert (bench.read(0x606C) == 0) is bool(option)
    assert state(bench) == end
    bench.write(0x6040, 0x0F)
    assert (state(bench) == ENABLED) is (end == QUICK_STOP)


@pytest.mark.parametrize(
    ("word", "index", "option", "left", "end"),
    [
        (0x06, 0x605B, 0, RUNS_OUT, 0x21),
        (0x06, 0x605B, 1, SLOWLY, 0x21),
        (0x07, 0x605C, 0, RUNS_OUT, 0x23),
        (0x07, 0x605C, 1, SLOWLY, 0x23),
        (0x00, 0x605B, 1, RUNS_OUT, DISABLED),
        (0x10F, 0x605D, 1, SLOWLY, ENABLED),
        (0x10F, 0x605D, 2, QUICKLY, ENABLED),
        (0x10F, 0x605D, 3, HARD, ENABLED),
    ],
)
def test_disabling_and_halt_follow_their_option_codes(word, index, option, left, end):
    """Shutdown, disable operation, disable voltage, halt: a ramp comes before the next state."""
    bench = turning(**{f"x{index:X}": option})
    bench.write(0x6040, word)
    bench.wait(0.1)
    assert bench.read(0x606C) / INCREMENTS == pytest.approx(left, abs=0.15)
    assert state(bench) == (end if left == RUNS_OUT else ENABLED)
    bench.wait(1.2)
    assert state(bench) == end
    assert (bench.read(0x606C) == 0) is (left != RUNS_OUT)


def test_disabling_is_cancelled_by_enable_and_overridden_by_quick_stop():
    bench = turning()
    bench.write(0x6040, 0x07)
    bench.wait(0.1)
    bench.write(0x6040, 0x0F)
    bench.wait(2.0)
    assert bench.read(0x606C) == pytest.approx(10 * INCREMENTS, rel=0.01)
    bench.write(0x6040, 0x07)
    bench.write(0x6040, 0x02)
    assert state(bench) == QUICK_STOP


@pytest.mark.parametrize(("option", "left"), [(0, RUNS_OUT), (1, SLOWLY), (2, QUICKLY), (3, HARD), (4, HARD)])
def test_fault_reaction_follows_its_option_code(option, left):
    bench = turning(x605E=option)
    bench.fault("follow_error=true")
    bench.wait(0.1)
    assert bench.read(0x606C) / INCREMENTS == pytest.approx(left, abs=0.3)
    assert state(bench) == (0x0F if option else FAULT)
    bench.wait(1.2)
    assert state(bench) == FAULT


def test_halt_in_torque_mode_brakes(bench):
    bench.enable(PT)
    bench.write(0x6071, 500)
    bench.wait(0.5)
    bench.write(0x6040, 0x10F)
    bench.wait(2.0)
    assert bench.read(0x606C) == 0
    bench.write(0x6040, 0x0F)
    bench.wait(0.5)
    assert bench.read(0x6077) == 500


@pytest.mark.parametrize(("option", "end"), [(0, ENABLED), (1, FAULT), (2, DISABLED), (3, DISABLED)])
def test_missing_master_heartbeat_triggers_the_configured_reaction(bench, option, end):
    bench.write(0x6007, option)
    bench.write(0x1016, 0x7F << 16 | 100, 1)
    bench.enable(PV)
    bench.write(0x60FF, INCREMENTS)
    bench.wait(1.0)
    assert state(bench) == ENABLED, "supervision starts with the first heartbeat"
    for _ in range(10):
        bench.send(0x77F, b"\x05")
        bench.wait(0.05)
    assert state(bench) == ENABLED
    bench.wait(0.5)
    assert bench.emergencies() == [(0x8130, 0x11)]
    assert state(bench) == end
    assert (bench.read(0x606C) == 0) is (option in (1, 3)), "a disabled drive coasts"
    bench.send(0x77F, b"\x05")
    bench.wait(0.02)
    assert bench.emergencies()[1:] == ([] if option == 1 else [(0, 0)])


@pytest.mark.parametrize(
    ("fault", "code", "register"),
    [("overcurrent", 0x2310, 0x03), ("overheat", 0x4310, 0x09), ("follow_error", 0x8611, 0x21)],
)
def test_fault_stops_the_drive_and_is_reset_when_its_cause_ends(bench, fault, code, register):
    bench.enable(PV)
    bench.write(0x60FF, 5 * INCREMENTS)
    bench.wait(1.0)
    bench.fault(f"{fault}@5=true")
    bench.wait(0.5)
    assert state(bench) == FAULT
    assert (bench.read(0x606C) == 0) is (fault != "overcurrent"), "without its power stage the motor coasts"
    assert bench.emergencies() == [(code, register)]
    assert (bench.read(0x603F), bench.read(0x1001)) == (code, register)
    bench.write(0x6040, 0x80)
    bench.wait(0.05)
    assert state(bench) == FAULT
    bench.fault(f"{fault}@5=false")
    bench.write(0x6040, 0x00)
    bench.write(0x6040, 0x80)
    bench.wait(0.05)
    assert state(bench) == DISABLED
    assert bench.emergencies()[-1] == (0, 0)
    assert (bench.read(0x603F), bench.read(0x1001)) == (0, 0)


def test_stuck_motor_gives_a_following_error(bench):
    bench.fault("stuck=true")
    bench.enable(PP)
    go_to(bench, 5 * INCREMENTS)
    bench.wait(1.0)
    assert state(bench) == FAULT
    assert bench.emergencies() == [(0x8611, 0x21)]
    assert bench.read(0x6064) == 0


def test_stuck_motor_in_velocity_mode_is_reported_as_blocked(bench):
    bench.fault("stuck=true")
    bench.enable(PV)
    bench.write(0x60FF, 5 * INCREMENTS)
    bench.wait(1.5)
    assert bench.emergencies() == [(0x7121, 0x21)]


def test_heartbeat_and_tpdos_can_fail_separately(bench):
    bench.operational()
    bench.fault("lost_heartbeat@5=true")
    bench.wait(0.01)
    received = {frame.identifier for frame in bench.wait(1.0)}
    assert received == {0x185, 0x285, 0x385, 0x485}
    bench.fault("lost_heartbeat@5=false", "lost_tpdo@5=true")
    bench.wait(0.01)
    assert {frame.identifier for frame in bench.wait(1.0)} == {0x705}


def test_nonsense_fault_sends_random_answers(bench):
    bench.fault("nonsense=1")
    answers = {bench.transfer(struct.pack("<BHB4x", 0x40, 0x6041, 0)) for _ in range(5)}
    assert len(answers) == 5


@pytest.mark.parametrize("brake", ["no", "yes"])
def test_load_needs_torque_or_a_brake(brake):
    bench = DriveBench(f",load=0.5,counts=4096,brake={brake}")
    bench.wait(0.1)
    assert bench.read(0x608F, 1) == 4096
    assert (bench.read(0x6064) == 0) is (brake == "yes"), "the load hangs before the drive is on"
    bench.enable(PV)
    bench.wait(1.0)
    assert bench.read(0x6077) == pytest.approx(500, abs=5)
    assert bench.read(0x606C) == pytest.approx(0, abs=20)
    bench.write(0x6072, 400)
    before = bench.read(0x6064)
    bench.wait(0.5)
    assert bench.read(0x6064) < before - 500, "the torque limit is below the load"
    bench.write(0x6040, 0)
    bench.wait(0.2)
    off = bench.read(0x6064)
    bench.wait(1.0)
    assert (bench.read(0x6064) == off) is (brake == "yes")
    assert (bench.read(0x606C) == 0) is (brake == "yes")
