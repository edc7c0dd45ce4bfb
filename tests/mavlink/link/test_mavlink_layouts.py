"""The driver's own decoder and packer give the same result as pymavlink."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc

from lfield_mavlink.link.dialect import COMPONENT, Reader, Writer, dialect

KINDS = sorted(dialect.mavlink_map)


def packed(kind, payload, sequence=7, system=3, component=1):
    head = (len(payload), 0, 0, sequence, system, component, kind & 0xFFFF, kind >> 16)
    body = struct.pack("<BBBBBBHB", *head) + payload
    extra = bytes([dialect.mavlink_map[kind].crc_extra])
    return b"\xfd" + body + struct.pack("<H", x25crc(body + extra).crc)


def seen(message):
    ids = (message.get_msgId(), message.get_srcSystem(), message.get_srcComponent(), message.get_seq())
    return type(message), ids, bytes(message.get_msgbuf()), repr(message.to_dict())


def assert_same(packet):
    (message,) = Reader().feed(packet)
    assert seen(message) == seen(dialect.MAVLink(None).decode(bytearray(packet)))


@settings(deadline=None)
@given(st.sampled_from(KINDS), st.binary(max_size=255), st.tuples(*[st.integers(0, 255)] * 3))
def test_any_payload_decodes_as_in_pymavlink(kind, payload, ids):
    assert_same(packed(kind, payload, *ids))


@pytest.mark.parametrize("fill", [b"\0", b"\xff", b"A"])
def test_every_message_type_decodes_as_in_pymavlink(fill):
    for kind in KINDS:
        for length in (1, dialect.mavlink_map[kind].unpacker.size, 255):
            assert_same(packed(kind, fill * length))


@settings(deadline=None)
@given(st.sampled_from(KINDS), st.binary(max_size=60), st.data())
def test_packet_with_one_wrong_bit_is_broken(kind, payload, data):
    packet = bytearray(packed(kind, payload))
    # The first three bytes give the end of a packet; if they are wrong, the reader waits for more.
    bit = data.draw(st.integers(8 * 3, 8 * len(packet) - 1))
    packet[bit // 8] ^= 1 << bit % 8
    reader = Reader()
    assert list(reader.feed(bytes(packet))) == []
    assert reader.broken == (int.from_bytes(packet[7:10], "little") in dialect.mavlink_map)


def test_spare_packet_is_not_decoded():
    requests = []

    def is_spare(header):
        requests.append(header)
        return header.system == 3

    reader = Reader()
    assert list(reader.feed(packed(0, bytes(9)), is_spare)) == []
    assert len(reader.feed(packed(0, bytes(9), system=4), is_spare)) == 1
    assert requests == [(3, 1, 0, 7), (4, 1, 0, 7)]


# TEST_TYPES has a field of one character; pymavlink cannot pack its own decoded value.
PACKED = [kind for kind in KINDS if kind != dialect.MAVLINK_MSG_ID_TEST_TYPES]


@settings(deadline=None)
@given(st.sampled_from(PACKED), st.binary(max_size=255), st.integers(0, 255))
def test_messages_are_packed_as_in_pymavlink(kind, payload, sequence):
    message = dialect.MAVLink(None).decode(bytearray(packed(kind, payload)))
    writer, other = Writer(), dialect.MAVLink(None, srcSystem=128, srcComponent=COMPONENT)
    writer._sequences[128] = other.seq = sequence
    assert writer.pack(message, 128) == message.pack(other)
    assert writer.pack(message, 128)[4] == (sequence + 1) % 256
    assert writer.pack(message, 129)[4:6] == bytes([0, 129]), "each system has its own sequence"
