"""A CiA 402 drive by frames on the time of the test: CANopen, the state machine, modes and faults."""

from __future__ import annotations

import struct

import pytest
from can_fake_bench import ACKNOWLEDGED, HOMED, LIMITED, REACHED, DriveBench, go_to, state

from lfield_sim.can.can_bus import CanFrame
from lfield_sim.can.cia402.cia402_table import CSP, CST, CSV, HM, INCREMENTS, PP, PT, PV, VENDOR


def test_drive_sends_boot_up_and_heartbeat():
    bench = DriveBench()
    received = bench.wait(1.05)
    assert received[0] == CanFrame(0x705, b"\x00")
    assert [frame.data for frame in received[1:]] == [b"\x7f"] * 5
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
    for word, expected in walk:
        bench.write(0x6040, word)
        assert state(bench) == expected, f"after controlword {word:#x}"


def test_tpdos_are_sent_by_timer_and_on_change(bench):
    bench.operational()
    received = [frame.identifier for frame in bench.wait(1.0)]
    assert [received.count(identifier) for identifier in (0x185, 0x285, 0x385, 0x485)] == [10, 20, 10, 5]
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
