"""Raw packets on the bus of the fake: answers of single servos and of groups."""

from __future__ import annotations

import struct

import pytest
from fake_bus import (
    ACCESS,
    ACTION,
    BAD_CRC,
    BAD_INSTRUCTION,
    BAUD,
    BROADCAST,
    CLEAR,
    GOAL,
    GOAL_VELOCITY,
    ID,
    LED,
    LENGTH,
    LIMIT,
    MODE,
    PING,
    POSITION,
    RANGE,
    READ,
    REBOOT,
    REG_WRITE,
    REGISTERED,
    RESET,
    RESULT_FAIL,
    TORQUE,
    VELOCITY_LIMIT,
    WRITE,
    Bus,
    parse,
    sync_read,
)

from lfield_sim.dynamixel.packets import Instruction, encode

# ---- single servos ----------------------------------------------------------------------------------


def test_pings_answer_in_the_order_of_ids():
    bus = Bus(5, 2, 9)
    assert bus.ask(5, PING) == [(5, 0, b"\xfc\x03\x34")]
    assert [id for id, _, _ in bus.ask(BROADCAST, PING)] == [2, 5, 9]
    assert bus.ask(77, PING) == []


@pytest.mark.parametrize(
    ("address", "data", "torque", "error"),
    [
        (LED, b"\x01", 0, 0),
        (GOAL, struct.pack("<i", 1000), 1, 0),
        (MODE, b"\x01", 0, 0),
        (MODE, b"\x01", 1, ACCESS),
        (MODE, b"\x02", 0, RANGE),
        (0, b"\x01\x00", 0, ACCESS),
        (POSITION, bytes(4), 0, ACCESS),
        (71, b"\x01", 0, ACCESS),
        (LED, b"\x02", 0, RANGE),
        (GOAL, b"\x01\x00", 0, LENGTH),
        (GOAL + 1, bytes(4), 0, LENGTH),
        (GOAL, b"", 0, LENGTH),
        (GOAL, struct.pack("<i", 5000), 0, LIMIT),
        (GOAL, struct.pack("<i", -1), 0, LIMIT),
        (GOAL, struct.pack("<i", 2_000_000), 0, RANGE),
        (GOAL_VELOCITY, struct.pack("<i", -201), 0, LIMIT),
        (VELOCITY_LIMIT, struct.pack("<i", 2000), 0, RANGE),
        (TORQUE, b"\x01\x01", 0, 0),
        (600, b"\x01", 0, LENGTH),
        (5000, b"\x01", 0, ACCESS),
    ],
)
def test_invalid_write_is_refused_with_its_error(address, data, torque, error):
    bus = Bus()
    assert bus.write(1, TORQUE, bytes([torque])) == 0
    before = bus.chain.servos[0].table.read(0, 120)
    assert bus.write(1, address, data) == error
    if error:
        assert bus.chain.servos[0].table.read(0, 120) == before, "an error changes no register"


def test_write_of_several_registers_is_all_or_nothing():
    bus = Bus()
    assert bus.write(1, TORQUE, b"\x01\x02") == RANGE
    assert bus.read(1, TORQUE, 2) == b"\x00\x00"


def test_read_beyond_the_table_or_too_short_is_an_error():
    bus = Bus()
    assert bus.ask(1, READ, struct.pack("<HH", 660, 10)) == [(1, ACCESS, b"")]
    assert bus.ask(1, READ, b"\x84") == [(1, LENGTH, b"")]
    assert bus.ask(1, 0x77) == [(1, BAD_INSTRUCTION, b"")]


def test_wrong_checksum_is_answered_by_the_addressed_servo():
    bus = Bus(1, 2)
    raw = bytearray(encode(2, WRITE, b"\x41\x00\x01"))
    raw[-1] ^= 1
    assert parse(bus.send(bytes(raw))) == [(2, BAD_CRC, b"")]
    assert bus.read(2, LED, 1) == b"\x00"
    raw = bytearray(encode(BROADCAST, PING))
    raw[-1] ^= 1
    assert bus.send(bytes(raw)) == b"", "a broadcast is not answered"


def test_status_return_level_selects_the_answers():
    bus = Bus()
    for level, read, write in ((2, True, True), (1, True, False), (0, False, False)):
        bus.chain.servos[0].table.put("status_return_level", level)
        assert bus.ask(1, PING)
        assert bool(bus.ask(1, READ, b"\x84\x00\x04\x00")) is read
        assert bool(bus.ask(1, WRITE, b"\x41\x00\x01")) is write
        assert bool(bus.send(sync_read(1))) is read
    assert bus.chain.servos[0].table["led"] == 1


def test_broadcast_writes_are_executed_without_answers():
    bus = Bus(1, 2)
    assert bus.ask(BROADCAST, WRITE, b"\x41\x00\x01") == []
    assert bus.read(1, LED, 1) == bus.read(2, LED, 1) == b"\x01"
    assert bus.ask(BROADCAST, REBOOT) == []
    assert bus.ask(BROADCAST, RESET, b"\xff") == []
    bus.wait(0.2)
    assert len(bus.ask(BROADCAST, PING)) == 2, "a broadcast reset keeps the ids"


def test_id_and_baud_rate_change_at_once():
    bus = Bus()
    bus.baud = 57_600
    assert bus.write(1, ID, b"\x07") == 0
    assert bus.ask(1, PING) == []
    assert bus.write(7, BAUD, b"\x03") == 0
    assert bus.ask(7, PING) == []
    bus.baud = 1_000_000
    assert len(bus.ask(7, PING)) == 1


def test_secondary_id_writes_ram_without_an_answer():
    bus = Bus(1, 2, secondary_id=100)
    assert bus.write(100, LED, b"\x01") is None
    assert bus.write(100, MODE, b"\x01") is None
    assert bus.read(1, LED, 1) == bus.read(2, LED, 1) == b"\x01"
    assert bus.read(1, MODE, 1) == b"\x03", "the EEPROM is unchanged"
    bus.chain.servos[0].table.put("secondary_id", 2)
    assert bus.write(2, LED, b"\x00") == 0, "the servo with this id answers"
    assert bus.read(1, LED, 1) == b"\x00"


def test_registered_writes_wait_for_action():
    bus = Bus()
    assert bus.ask(1, ACTION) == [(1, RESULT_FAIL, b"")]
    assert bus.ask(1, REG_WRITE, b"\x41\x00\x01") == [(1, 0, b"")]
    assert bus.read(1, LED, 1) + bus.read(1, REGISTERED, 1) == b"\x00\x01"
    assert bus.ask(1, ACTION) == [(1, 0, b"")]
    assert bus.read(1, LED, 1) + bus.read(1, REGISTERED, 1) == b"\x01\x00"
    assert bus.ask(1, REG_WRITE, b"\x41\x00\x09") == [(1, RANGE, b"")]


def test_reboot_is_answered_before_the_servo_restarts():
    bus = Bus()
    bus.write(1, LED, b"\x01")
    assert bus.ask(1, REBOOT) == [(1, 0, b"")]
    assert bus.ask(1, PING) == []
    bus.wait(0.15)
    assert bus.read(1, LED, 1) == b"\x00"


@pytest.mark.parametrize(("option", "id", "baud"), [(0xFF, 1, 57_600), (1, 9, 57_600), (2, 9, 1_000_000)])
def test_factory_reset_keeps_the_selected_settings(option, id, baud):
    bus = Bus(9, baud_rate=3, velocity_limit=100)
    assert bus.ask(9, RESET, bytes([option])) == [(9, 0, b"")]
    bus.wait(0.15)
    servo = bus.chain.servos[0]
    assert (servo.id, servo.baud, servo.table["velocity_limit"]) == (id, baud, 200)
    assert bus.ask(id, RESET, b"\x07") == [(id, RANGE, b"")]


def test_clear_resets_turns_only_at_rest():
    bus = Bus(operating_mode=4)
    bus.chain.servos[0].motion.motor.angle += 12.0
    turns = b"\x01\x44\x58\x4c\x22"
    assert bus.ask(1, CLEAR, b"\x02") == [(1, RANGE, b"")]
    assert bus.ask(1, CLEAR, turns) == [(1, 0, b"")]
    assert 0 <= struct.unpack("<i", bus.read(1, POSITION, 4))[0] < 4096
    bus.write(1, TORQUE, b"\x01")
    bus.write(1, GOAL, struct.pack("<i", 100_000))
    bus.wait(0.3)
    assert bus.ask(1, CLEAR, turns) == [(1, RESULT_FAIL, b"")]


@pytest.mark.parametrize(("model", "data"), [("XM430-W350", 224), ("XL330-M288", 208)])
def test_indirect_addresses_read_and_write_their_registers(model, data):
    bus = Bus(model=model)
    assert bus.write(1, data, b"\x2a") == 0, "initially each pointer refers to its own byte"
    assert bus.read(1, data, 1) == b"\x2a"
    pointers = [POSITION, POSITION + 1, POSITION + 2, POSITION + 3, 146, GOAL, GOAL + 1, GOAL + 2, GOAL + 3]
    assert bus.write(1, 168, struct.pack("<9H", *pointers)) == 0
    assert bus.read(1, data, 5) == struct.pack("<iB", 2048, 30)
    assert bus.write(1, data + 5, struct.pack("<i", 1234)) == 0
    assert bus.read(1, GOAL, 4) == struct.pack("<i", 1234)
    assert bus.write(1, data + 5, b"\x01") == LENGTH
    assert bus.write(1, data, b"\x01\x00\x00\x00") == ACCESS
    assert bus.write(1, 168, b"\x01\x00") == RANGE


def test_data_equal_to_a_header_is_stuffed():
    bus = Bus()
    bus.write(1, 224, b"\xff\xff\xfd\x00\xff\xff\xfd")
    assert bus.read(1, 224, 7) == b"\xff\xff\xfd\x00\xff\xff\xfd"


# ---- groups -----------------------------------------------------------------------------------------


def test_group_read_answers_in_list_order_up_to_a_missing_servo():
    bus = Bus(1, 2, 3)
    assert [id for id, _, _ in parse(bus.send(sync_read(3, 1, 2)))] == [3, 1, 2]
    assert [id for id, _, _ in parse(bus.send(sync_read(3, 77, 2)))] == [3]
    requests = struct.pack("<BHHBHH", 2, 144, 2, 1, 146, 1)
    assert bus.ask(BROADCAST, Instruction.BULK_READ, requests) == [(2, 0, b"\x78\x00"), (1, 0, b"\x1e")]


def test_fast_read_packet_ends_at_a_missing_servo():
    bus = Bus(1, 2, 3)
    ((id, error, data),) = parse(bus.send(sync_read(2, 3, fast=True)))
    assert (id, error, data[0]) == (BROADCAST, 0, 2)
    assert data[1:5] == struct.pack("<i", 2048)
    assert data[7:9] == b"\x00\x03"
    requests = struct.pack("<BHHBHH", 2, 144, 2, 1, 146, 1)
    answers = bus.send(encode(BROADCAST, Instruction.FAST_BULK_READ, requests))
    assert parse(answers)[0][2][:3] == b"\x02\x78\x00"
    cut = bus.send(sync_read(2, 77, 3, fast=True))
    assert len(cut) == 8 + 8, "one block of three"
    assert int.from_bytes(cut[5:7], "little") == 1 + 3 * 8
    assert bus.send(sync_read(77, 2, fast=True)) == b""


def test_group_writes_are_never_answered():
    bus = Bus(1, 2, 3)
    assert (
        bus.send(encode(BROADCAST, Instruction.SYNC_WRITE, struct.pack("<HHBBBBB", LED, 1, 1, 1, 2, 9, 3)))
        == b""
    )
    assert (
        bus.send(encode(BROADCAST, Instruction.SYNC_WRITE, struct.pack("<HHBBBB", LED, 1, 1, 1, 2, 9))) == b""
    )
    assert bus.read(1, LED, 1) + bus.read(2, LED, 1) == b"\x01\x00", "a value out of range is ignored"
    bulk = struct.pack("<BHHBBHHi", 1, LED, 1, 0, 2, GOAL, 4, 777)
    assert bus.send(encode(BROADCAST, Instruction.BULK_WRITE, bulk)) == b""
    assert bus.read(1, LED, 1) + bus.read(2, GOAL, 4) == b"\x00" + struct.pack("<i", 777)


def test_invalid_group_reads_are_not_answered():
    bus = Bus(1, 2)
    assert bus.send(sync_read(1, 2, 1)) == b""
    requests = struct.pack("<BHHBHH", 1, 0, 660, 2, 0, 660)
    assert bus.send(encode(BROADCAST, Instruction.FAST_BULK_READ, requests)) == b""
    assert len(bus.ask(BROADCAST, Instruction.BULK_READ, requests)) == 2
