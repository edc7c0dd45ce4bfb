"""A CiA 402 drive by frames on the time of the test: CANopen, the state machine, modes and faults."""

from __future__ import annotations

import struct

import pytest
from can_fake_bench import DriveBench

from lfield_sim.can.can_bus import CanFrame
from lfield_sim.can.cia402.cia402_table import CSP, CST, CSV, HM, INCREMENTS, PP, PT, PV, VENDOR

ENABLED, QUICK_STOP, FAULT, DISABLED = 0x27, 0x07, 0x08, 0x40
REACHED, LIMITED, ACKNOWLEDGED, HOMED = 1 << 10, 1 << 11, 1 << 12, 1 << 12


@pytest.fixture
def bench() -> DriveBench:
    bench = DriveBench()
    bench.wait(0.1)
    return bench


def state(bench: DriveBench) -> int:
    return bench.status & 0x6F


def test_drive_sends_boot_up_and_heartbeat():
    bench = DriveBench()
    heard = bench.wait(1.05)
    assert heard[0] == CanFrame(0x705, b"\x00")
    assert [frame.data for frame in heard[1:]] == [b"\x7f"] * 5
    bench.operational()
    assert bench.last(0x705) == b"\x05" or bench.wait(0.2)
    bench.send(0x000, b"\x02\x00")
    bench.wait(0.3)
    assert bench.last(0x705) == b"\x04"
    bench.send(0x000, b"\x81\x05")
    assert bench.wait()[0] == CanFrame(0x705, b"\x00")
    bench.send(0x000, b"\x81\x06")
    assert bench.wait() == [], "a reset of another node"


def test_identity_and_device_name_are_read(bench):
    assert bench.read(0x1018, 1) == VENDOR
    assert bench.read(0x1000) & 0xFFFF == 0x0192
    assert bench.transfer(struct.pack("<BHB4x", 0x40, 0x1008, 0))[:1] == b"\x41"
    text, toggle = b"", 0
    while True:
        segment = bench.transfer(bytes([0x60 | toggle]) + bytes(7))
        assert segment[0] & 0x10 == toggle
        text += segment[1 : 8 - (segment[0] >> 1 & 7)]
        toggle ^= 0x10
        if segment[0] & 1:
            break
    assert text == b"lfield fake CiA 402 drive"


@pytest.mark.parametrize(
    ("index", "subindex", "code"), [(0x5555, 0, 0x06020000), (0x1018, 9, 0x06090011), (0x6040, 1, 0x06090011)]
)
def test_read_of_an_absent_object_is_aborted(bench, index, subindex, code):
    assert bench.abort(index, subindex) == code


@pytest.mark.parametrize(
    ("index", "subindex", "value", "code"),
    [
        (0x6041, 0, 0, 0x06010002),
        (0x6060, 0, 7, 0x06090030),
        (0x6072, 0, 3001, 0x06090031),
        (0x6084, 0, 0, 0x06090032),
        (0x1A00, 1, 0x60640020, 0x08000022),
    ],
)
def test_invalid_write_is_aborted_and_keeps_the_value(bench, index, subindex, value, code):
    before = bench.read(index, subindex)
    assert bench.write(index, value, subindex) == code
    assert bench.read(index, subindex) == before or index == 0x6041


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        ("2340600001000000", 0x06070012),
        ("2f7a600001000000", 0x06070013),
        ("6000000000000000", 0x05040001),
        ("a040600000000000", 0x05040001),
    ],
)
def test_invalid_sdo_request_is_aborted(bench, request_, code):
    answer = bench.transfer(bytes.fromhex(request_))
    assert answer[0] == 0x80
    assert int.from_bytes(answer[4:], "little") == code


def test_segmented_download_and_wrong_toggle(bench):
    assert bench.transfer(struct.pack("<BHBL", 0x21, 0x607A, 0, 4))[0] == 0x60
    assert bench.transfer(b"\x07" + struct.pack("<l", -7) + bytes(3))[0] == 0x20
    assert bench.read(0x607A) == -7
    bench.transfer(struct.pack("<BHBL", 0x21, 0x607A, 0, 4))
    assert bench.transfer(b"\x17" + bytes(7))[4:] == struct.pack("<L", 0x05030000)


def test_state_machine_follows_the_control_word(bench):
    walk = [
        (0x0F, 0x40),
        (0x06, 0x21),
        (0x07, 0x23),
        (0x0F, 0x27),
        (0x07, 0x23),
        (0x06, 0x21),
        (0x0F, 0x27),
        (0x00, 0x40),
        (0x06, 0x21),
        (0x02, 0x40),
    ]
    for word, wanted in walk:
        bench.write(0x6040, word)
        assert state(bench) == wanted, f"after controlword {word:#x}"


def test_tpdos_are_sent_by_timer_and_on_change(bench):
    bench.operational()
    heard = [frame.identifier for frame in bench.wait(1.0)]
    assert [heard.count(identifier) for identifier in (0x185, 0x285, 0x385, 0x485)] == [10, 20, 10, 5]
    bench.send(0x205, struct.pack("<Hb", 0x06, PV))
    changed = [frame.data for frame in bench.wait(0.01) if frame.identifier == 0x185]
    assert struct.unpack("<HbB", changed[0]) == (0x0231, PV, 0)


def test_pdo_remapping_follows_canopen(bench):
    bench.write(0x1800, 1 << 31 | 0x185, 1)
    assert bench.write(0x1A00, 0x60640020, 1) == 0x08000022, "not possible while it has entries"
    assert bench.write(0x1A00, 0) == 0
    assert bench.write(0x1A00, 0x60640020, 1) == 0
    assert bench.write(0x1A00, 0x10080008, 2) == 0x06040041
    assert bench.write(0x1A00, 0x12340008, 2) == 0x06020000
    assert bench.write(0x1A00, 0x606C0020, 2) == 0
    assert bench.write(0x1A00, 0x60770010, 3) == 0
    assert bench.write(0x1A00, 3) == 0x06040042
    assert bench.write(0x1A00, 2) == 0
    bench.write(0x1800, 1, 2)
    bench.write(0x1800, 0x185, 1)
    bench.operational()
    assert 0x185 not in [frame.identifier for frame in bench.wait(0.5)]
    bench.send(0x080)
    assert [len(f.data) for f in bench.wait() if f.identifier == 0x185] == [8]


def test_short_pdo_is_an_emergency(bench):
    bench.operational()
    bench.send(0x305, b"\x0f")
    bench.wait(0.02)
    assert bench.emergencies() == [(0x8210, 0x10)]
    assert bench.read(0x1001) == 0x10
    assert bench.read(0x1003, 1) == 0x8210


def test_synchronous_pdos_wait_for_sync(bench):
    bench.write(0x1401, 1, 2)
    bench.operational()
    bench.send(0x305, struct.pack("<Hl", 0, 77))
    bench.wait()
    assert bench.read(0x607A) == 0
    bench.send(0x080)
    bench.wait()
    assert bench.read(0x607A) == 77


def go_to(bench: DriveBench, increments: int, *, extra: int = 0) -> None:
    bench.write(0x607A, increments)
    bench.write(0x6040, 0x1F | extra)
    assert bench.status & ACKNOWLEDGED
    bench.write(0x6040, 0x0F | extra)


def test_profile_position_follows_a_trapezoid(bench):
    bench.enable(PP)
    go_to(bench, 10 * INCREMENTS)
    assert not bench.status & (REACHED | ACKNOWLEDGED)
    speeds = []
    for _ in range(300):
        bench.wait(0.01)
        speeds.append(bench.drive.axis.drive.velocity / INCREMENTS)
    assert max(speeds) == pytest.approx(5.0, abs=0.1), "0x6081: 5 turns per second"
    assert speeds[20] == pytest.approx(2.1, abs=0.3), "0x6083: 10 turns per second squared"
    assert bench.status & REACHED
    assert bench.read(0x6064) == pytest.approx(10 * INCREMENTS, abs=40)
    assert max(bench.drive.axis.drive.profile.position, bench.drive.axis.drive.position) < 10.01 * INCREMENTS


def test_setpoints_are_queued_replaced_and_relative(bench):
    bench.enable(PP)
    go_to(bench, 2 * INCREMENTS)
    bench.write(0x607A, 0)
    bench.write(0x6040, 0x1F)
    bench.write(0x6040, 0x0F)
    assert bench.status & ACKNOWLEDGED, "one setpoint is queued: no other is accepted"
    bench.wait(1.0)
    assert not bench.status & ACKNOWLEDGED
    bench.wait(1.5)
    assert bench.read(0x6064) == pytest.approx(0, abs=40)
    go_to(bench, 5 * INCREMENTS)
    go_to(bench, -INCREMENTS, extra=0x20)
    bench.wait(3.0)
    assert bench.read(0x6064) == pytest.approx(-INCREMENTS, abs=40)
    go_to(bench, INCREMENTS // 2, extra=0x40)
    bench.wait(2.0)
    assert bench.read(0x6064) == pytest.approx(-INCREMENTS // 2, abs=40)


def test_halt_and_software_limits(bench):
    bench.write(0x607D, -INCREMENTS, 1)
    bench.write(0x607D, INCREMENTS, 2)
    bench.enable(PP)
    go_to(bench, 5 * INCREMENTS)
    assert bench.status & LIMITED
    bench.wait(0.1)
    bench.write(0x6040, 0x10F)
    bench.wait(1.0)
    halted = bench.read(0x6064)
    assert 0 < halted < INCREMENTS
    assert bench.status & REACHED
    bench.write(0x6040, 0x0F)
    bench.wait(2.0)
    assert bench.read(0x6064) == pytest.approx(INCREMENTS, abs=40)


@pytest.mark.parametrize("mode", [PV, CSV])
def test_velocity_modes_reach_the_target_and_the_limit(bench, mode):
    bench.enable(mode)
    bench.write(0x60FF, 2 * INCREMENTS)
    bench.wait(1.0)
    assert bench.read(0x606C) == pytest.approx(2 * INCREMENTS, rel=0.01)
    assert bool(bench.status & REACHED) is (mode == PV)
    bench.write(0x60FF, 1000 * INCREMENTS)
    bench.wait(8.0)
    assert bench.read(0x606C) == pytest.approx(50 * INCREMENTS, rel=0.01), "0x6080: 3000 turns per minute"


@pytest.mark.parametrize("mode", [PT, CST])
def test_torque_modes_apply_the_torque_up_to_the_speed_limit(bench, mode):
    bench.enable(mode)
    bench.write(0x6071, 100)
    bench.wait(0.1)
    assert bench.read(0x6077) == 100
    assert bench.drive.axis.drive.velocity > 0
    bench.wait(5.0)
    assert bench.read(0x606C) <= 50 * INCREMENTS * 1.01


def test_cyclic_position_follows_the_setpoints(bench):
    bench.enable(CSP)
    for n in range(1, 101):
        bench.write(0x607A, n * 100)
        bench.wait(0.005)
    bench.wait(0.2)
    assert bench.read(0x6064) == pytest.approx(10_000, abs=20)


@pytest.mark.parametrize(("method", "position"), [(35, 500), (17, 500)])
def test_homing_sets_the_position_offset(bench, method, position):
    bench.write(0x6098, method)
    bench.write(0x607C, position)
    bench.enable(HM)
    bench.write(0x6040, 0x1F)
    bench.wait(0.02)
    assert bool(bench.status & HOMED) is (method == 35)
    bench.wait(2.0)
    assert bench.status & HOMED
    assert bench.status & REACHED
    assert bench.read(0x6064) == pytest.approx(position, abs=40)


def test_homing_without_a_method_is_an_error(bench):
    bench.enable(HM)
    bench.write(0x6040, 0x1F)
    assert bench.status & 1 << 13


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
    heard = {frame.identifier for frame in bench.wait(1.0)}
    assert heard == {0x185, 0x285, 0x385, 0x485}
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
