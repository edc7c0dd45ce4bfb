"""Packets of the fake equal those of the manual and of the vendor, and random bytes are skipped."""

from __future__ import annotations

import pytest
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from lfield_sim.dynamixel.packets import (
    MAX_PACKET,
    Codec1,
    Codec2,
    crc16,
    encode,
    encode1,
    fast_status,
    stuff,
    unstuff,
)

#: Examples of https://emanual.robotis.com/docs/en/dxl/protocol2/: packet, id, instruction, parameters.
MANUAL = [
    ("FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E", 1, 0x04, "68 00 C8 00 00 00"),
    ("FF FF FD 00 01 03 00 05 02 CE", 1, 0x05, ""),
    ("FF FF FD 00 01 04 00 06 01 A1 E6", 1, 0x06, "01"),
    ("FF FF FD 00 01 03 00 08 2F 4E", 1, 0x08, ""),
    ("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA", 0xFE, 0x82, "84 00 04 00 01 02"),
]
#: Data with many packet headers.
mostly_headers = st.lists(st.sampled_from([0xFF, 0xFF, 0xFD, 0xFD, 0x00, 0x01, 0x55])).map(bytes)


@pytest.mark.parametrize(("raw", "id", "instruction", "parameters"), MANUAL)
def test_instruction_equals_the_example_of_the_manual(raw, id, instruction, parameters):
    packet = bytes.fromhex(raw)
    assert encode(id, instruction, bytes.fromhex(parameters)) == packet
    (read,) = Codec2().feed(packet)
    assert (read.id, read.instruction, read.parameters.hex()) == (
        id,
        instruction,
        bytes.fromhex(parameters).hex(),
    )
    assert read.is_valid
    assert read.size == len(packet)


def test_status_equals_the_example_of_the_manual():
    assert Codec2().status(2, 0, bytes.fromhex("1F 08 00 00")) == bytes.fromhex(
        "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
    )


def test_protocol_1_equals_the_example_of_the_manual():
    # https://emanual.robotis.com/docs/en/dxl/protocol1/: read the present position's address 0x2B of id 1.
    packet = bytes.fromhex("FF FF 01 04 02 2B 01 CC")
    assert encode1(1, 2, b"\x2b\x01") == packet
    (read,) = Codec1().feed(packet)
    assert (read.id, read.instruction, read.parameters) == (1, 2, b"\x2b\x01")


@given(st.binary(max_size=100))
def test_checksum_equals_that_of_the_vendor(data):
    assert crc16(data) == Protocol2PacketHandler().updateCRC(0, data, len(data))


@given(mostly_headers)
def test_fake_stuffing_is_reversible(data):
    assert unstuff(stuff(data)) == data
    assert b"\xff\xff\xfd\x00" not in stuff(data)


@given(st.integers(0, 252), st.integers(1, 255), mostly_headers | st.binary(max_size=300), st.integers(1, 40))
def test_packets_are_read_for_every_split_of_the_bytes(id, instruction, parameters, cut):
    for codec, make in ((Codec2(), encode), (Codec1(), encode1)):
        parameters = parameters[:200]
        raw = make(id, instruction, parameters)
        found = [p for at in range(0, len(raw), cut) for p in codec.feed(raw[at : at + cut])]
        assert [(p.id, p.instruction, p.parameters, p.is_valid) for p in found] == [
            (id, instruction, parameters, True)
        ]


@given(st.lists(mostly_headers | st.binary(max_size=80), max_size=6))
def test_noise_is_skipped_and_the_next_packet_is_found(pieces):
    codec = Codec2()
    for piece in pieces:
        codec.feed(piece)
        assert len(codec._buffer) <= MAX_PACKET
    packet = encode(7, 2, b"\x84\x00\x04\x00")
    # With a damaged length one packet may be lost; the header of the next packet ends it.
    found = codec.feed(packet) + codec.feed(packet)
    assert [p.id for p in found if p.is_valid][-1:] == [7]


@given(st.integers(7, 12), st.integers(1, 255))
def test_damaged_byte_is_detected(place, change):
    raw = bytearray(encode(1, 2, b"\x84\x00\x04\x00"))
    raw[place] ^= change
    assert [p.is_valid for p in Codec2().feed(bytes(raw))] == [False]


def test_fast_status_has_a_cumulative_checksum_per_block():
    packet = fast_status(16, [(3, 0, b"\xa6\x00\x00\x00"), (7, 0, b"\x1f\x08\x00\x00")])
    assert packet[:8] == bytes.fromhex("FF FF FD 00 FE 11 00 55")
    assert crc16(packet[:14]) == int.from_bytes(packet[14:16], "little")
    assert crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
