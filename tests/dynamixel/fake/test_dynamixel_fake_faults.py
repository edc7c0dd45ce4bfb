"""Times of answers, protocol 1.0, faults and random bytes on a chain of simulated servos."""

from __future__ import annotations

import struct

import pytest
from fake_bus import (
    ALERT,
    BROADCAST,
    GOAL,
    HARDWARE,
    LED,
    PING,
    POSITION,
    RANGE,
    READ,
    REBOOT,
    TORQUE,
    WRITE,
    Bus,
    parse,
    sync_read,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from lfield_sim.dynamixel.packets import Instruction, encode, encode1

# ---- times of answers --------------------------------------------------------------------------------------


def test_answer_takes_transmission_time_and_return_delay():
    bus = Bus(1, 2)
    question = encode(1, READ, b"\x84\x00\x04\x00")
    (reply,) = bus.chain.receive(question, 1.0, 57_600)
    assert reply.at == pytest.approx(1.0 + (14 + 15) * 10 / 57_600 + 500e-6)
    first, second = bus.chain.receive(sync_read(1, 2), 2.0, 57_600)
    assert second.at - first.at == pytest.approx(15 * 10 / 57_600 + 500e-6)


def test_number_and_delay_of_answers_to_a_flood_of_requests_are_bounded():
    bus = Bus()
    flood = encode(1, PING) * 2000
    replies = bus.chain.receive(flood, 1.0, 57_600)
    assert replies[1].at > replies[0].at
    assert replies[-1].at < 2.1
    assert len(replies) < 300


def test_wrong_baud_rate_or_half_a_packet_gets_no_answer():
    bus = Bus()
    bus.baud = 115_200
    assert bus.ask(1, PING) == []
    bus.baud = 57_600
    raw = encode(1, PING)
    assert bus.send(raw[:5]) == b""
    assert len(parse(bus.send(raw[5:]))) == 1
    bus.send(raw[:5])
    bus.wait(0.2)
    assert bus.send(raw[5:]) == b"", "the rest of the packet is too late"
    assert len(bus.ask(1, PING)) == 1


def test_any_valid_packet_on_the_bus_resets_every_watchdog():
    bus = Bus(1, 2, bus_watchdog=10)
    bus.write(1, TORQUE, b"\x01")
    for _ in range(10):
        bus.wait(0.15)
        bus.ask(2, PING)
    assert bus.read(1, 98, 1) == b"\x0a"
    broken = encode(2, PING)[:-1] + b"\x00"
    for _ in range(2):
        bus.wait(0.15)
        bus.send(broken)
    assert bus.read(1, 98, 1) == b"\xff"


# ---- protocol 1.0 -----------------------------------------------------------------------------------


def test_fake_answers_and_refuses_protocol_1_packets():
    bus = Bus(protocol_type=1)
    assert bus.ask(1, PING) == []
    assert bus.send(encode1(1, PING)) == bytes.fromhex("FF FF 01 02 00 FC")
    assert bus.send(encode1(1, READ, b"\x84\x04"))[5:9] == struct.pack("<i", 2048)
    assert bus.send(encode1(1, WRITE, b"\x41\x09"))[4] == 0x08
    assert bus.send(encode1(1, 0x77))[4] == 0x40
    assert bus.send(encode1(BROADCAST, Instruction.SYNC_WRITE, b"\x41\x01\x01\x01")) == b""
    assert bus.send(encode1(BROADCAST, Instruction.BULK_READ, b"\x00\x01\x01\x41"))[5] == 1
    assert bus.send(encode1(1, READ, b"\x00\xfe"))[4] == 0x08, "longer than the longest answer"
    raw = bytearray(encode1(1, PING))
    raw[-1] ^= 1
    assert bus.send(bytes(raw))[4] == 0x10


# ---- faults -----------------------------------------------------------------------------------------


def test_dead_servo_ends_a_group_read():
    bus = Bus(1, 2, 3)
    bus.chain.faults.apply(["dead@2=true"])
    assert bus.ask(2, PING) == []
    assert [id for id, _, _ in parse(bus.send(sync_read(1, 2, 3)))] == [1]
    bus.ask(BROADCAST, WRITE, b"\x41\x00\x01")
    assert bus.chain.servos[1].table["led"] == 0


def test_writes_with_lost_replies_are_executed_and_one_byte_is_corrupted():
    bus = Bus(1, 2, 3)
    bus.chain.faults.apply(["lose@2=1"])
    assert bus.write(2, LED, b"\x01") is None
    assert bus.chain.servos[1].table["led"] == 1, "the write was executed"
    assert [id for id, _, _ in parse(bus.send(sync_read(1, 2, 3)))] == [1, 3], (
        "the other servos received the request"
    )
    assert len(bus.send(sync_read(1, 2, 3, fast=True))) == 16
    bus.chain.faults.apply(["lose@2=0", "corrupt@1=1"])
    good, bad = encode(1, 0x55, b"\x00\xfc\x03\x34"), bus.send(encode(1, PING))
    assert sum(a != b for a, b in zip(good, bad, strict=True)) == 1


def test_faults_delay_answers_change_their_ids_and_garble_them():
    bus = Bus(1)
    bus.chain.faults.apply(["delay=0.5"])
    assert bus.chain.receive(encode(1, PING), 5.0)[0].at > 5.5
    bus.chain.faults.apply(["delay=0", "other=true"])
    bus.now = 6.0
    assert bus.ask(1, PING)[0][0] == 2
    bus.chain.faults.apply(["other=false", "nonsense=true"])
    assert bus.send(encode(1, PING))[:4] != b"\xff\xff\xfd\x00"
    bus.chain.faults.apply(["nonsense=false", "noise=1"])
    assert len(bus.send(encode(1, PING))) > 14


def test_overload_trips_and_sets_the_alert_bit():
    bus = Bus(1, 2)
    bus.write(1, TORQUE, b"\x01")
    bus.chain.faults.apply(["overload@1=true"])
    bus.wait(2.0)
    assert bus.ask(1, PING)[0][1] == ALERT
    assert bus.write(1, TORQUE, b"\x05") == ALERT | RANGE
    assert bus.ask(2, PING)[0][1] == 0
    assert bus.chain.servos[0].table["torque_enable"] == 0
    bus.chain.faults.apply(["overload@1=false"])
    bus.ask(1, REBOOT)
    bus.wait(0.2)
    assert bus.ask(1, PING)[0][1] == 0


def test_stuck_servo_does_not_move_and_reports_no_error():
    bus = Bus()
    bus.chain.faults.apply(["stuck=true"])
    bus.write(1, TORQUE, b"\x01")
    bus.write(1, GOAL, struct.pack("<i", 3000))
    bus.wait(3.0)
    assert bus.read(1, POSITION, 4) == struct.pack("<i", 2048)
    assert bus.read(1, HARDWARE, 1) == b"\x00"


def test_faults_stay_with_the_servo_after_a_change_of_its_id():
    bus = Bus()
    bus.chain.faults.apply(["dead@1=true"])
    bus.chain.servos[0].table.put("id", 5)
    assert bus.ask(5, PING) == []


# ---- random bytes ----------------------------------------------------------------------------------

instructions = st.sampled_from([*Instruction, 0x55, 0x77])
pieces = st.one_of(
    st.binary(max_size=60),
    st.builds(encode, st.sampled_from([1, 2, 9, 100, BROADCAST]), instructions, st.binary(max_size=30)),
    st.builds(encode1, st.sampled_from([1, 2, 9, BROADCAST]), instructions, st.binary(max_size=30)),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(pieces, st.floats(0.0, 0.3)), max_size=8), st.sampled_from([1, 2]))
def test_bus_answers_the_next_packet_after_any_bytes(pieces, protocol):
    bus = Bus(1, 2, protocol_type=protocol, return_delay_time=0, secondary_id=100)
    for piece, pause in pieces:
        bus.wait(pause)
        assert len(bus.send(piece)) <= 8 * (len(piece) + 1) * 700
    bus.wait(0.5)
    servo = bus.chain.servos[0]
    servo.table.put("status_return_level", 2)
    ping = encode(servo.id, PING) if servo.protocol == 2 else encode1(servo.id, PING)
    assert bus.send(ping), "no answer to the next packet"
    assert all(len(codec._buffer) <= 1024 for codec in bus.chain._codecs.values())
