"""Packets equal those of the SDK of the vendor, and the readers accept any bytes."""

from __future__ import annotations

import pytest
from dynamixel_sdk import PacketHandler
from hypothesis import assume, example, given
from hypothesis import strategies as st

from lfield_dynamixel.bus.packets import (
    MAX_BUFFER,
    Protocol1,
    Protocol2,
    Reader1,
    Reader2,
    Status,
    crc16,
    split_fast,
    stuff,
    unstuff,
)


class Wire:
    """A port for the SDK of the vendor. It stores the written bytes and returns the given answer."""

    def __init__(self, answer: bytes = b"") -> None:
        self.is_using, self.written, self.answer = False, b"", answer

    def clearPort(self):  # the SDK defines the names of these methods
        pass

    def writePort(self, packet):
        self.written = bytes(packet)
        return len(packet)

    def readPort(self, length):
        data, self.answer = self.answer[:length], self.answer[length:]
        return list(data)

    def setPacketTimeout(self, length):
        pass

    def isPacketTimeout(self):
        return not self.answer


NUMBERS = st.integers(0, 252)
# Data with many packet headers and stuffed bytes.
TRICKY = st.lists(st.sampled_from([b"\xff", b"\xfd", b"\x00", b"\x55", b"\x01"]), max_size=60).map(b"".join)


def status2(number: int, error: int, data: bytes) -> bytes:
    body = stuff(b"\x55" + bytes((error,)) + data)
    packet = b"\xff\xff\xfd\0" + bytes((number,)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def status1(number: int, error: int, data: bytes) -> bytes:
    body = bytes((number, len(data) + 2, error)) + data
    return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))


def test_packet_equals_the_example_of_the_protocol_page():
    clear = Protocol2.encode(1, 0x10, bytes((0x01, 0x44, 0x58, 0x4C, 0x22)))
    assert clear.hex(" ") == "ff ff fd 00 01 08 00 10 01 44 58 4c 22 b1 dc"


@given(NUMBERS, st.integers(0, 0xFFFF), TRICKY | st.binary(max_size=60))
def test_write_equals_that_of_the_vendor_sdk(number, address, data):
    # The SDK (4.1.0) discards the stuffed packet and sends the packet without stuffing.
    assume(b"\xff\xff\xfd" not in address.to_bytes(2, "little") + data)
    wire = Wire()
    PacketHandler(2.0).writeTxOnly(wire, number, address, len(data), list(data))
    assert Protocol2.encode(number, 3, address.to_bytes(2, "little") + data) == wire.written


@given(NUMBERS, st.integers(0, 0xFF), st.binary(max_size=60))
def test_protocol_1_write_equals_that_of_the_vendor_sdk(number, address, data):
    wire = Wire()
    PacketHandler(1.0).writeTxOnly(wire, number, address, len(data), list(data))
    assert Protocol1.encode(number, 3, bytes((address,)) + data) == wire.written


def sdk_misreads(body: bytes) -> bool:
    """After the first stuffed byte, the SDK removes a byte of every FF FD FD, also if none was stuffed."""
    first = body.find(b"\xff\xff\xfd")
    return first >= 0 and b"\xff\xfd\xfd" in body[first + 2 :]


@given(NUMBERS, st.integers(0, 255), TRICKY.filter(bool))
@example(0, 0, b"\xff\xff\xfd\xff\xfd\xfd")
def test_answer_is_read_as_the_vendor_sdk_reads_it(number, error, data):
    packet = status2(number, error, data)
    if sdk_misreads(bytes((error,)) + data):
        assert Reader2().feed(packet) == [Status(number, error, data)]
        return
    received, _, vendor_error = PacketHandler(2.0).readRx(Wire(packet), number, len(data))
    assert Reader2().feed(packet) == [Status(number, vendor_error, bytes(received))]


@given(TRICKY | st.binary())
def test_stuffing_is_reversible(body):
    assert unstuff(stuff(body)) == body
    assert stuff(body).count(b"\xff\xff\xfd") == stuff(body).count(b"\xff\xff\xfd\xfd")


@pytest.mark.parametrize(("reader", "status"), [(Reader1, status1), (Reader2, status2)])
@given(st.lists(st.tuples(NUMBERS, st.integers(0, 255), st.binary(max_size=40)), max_size=5), st.data())
def test_answers_are_read_for_every_split_of_the_bytes(reader, status, answers, data):
    stream = b"".join(status(*answer) for answer in answers)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    stream_reader, found = reader(), []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += stream_reader.feed(stream[start:end])
    assert found == [Status(*answer) for answer in answers]


@pytest.mark.parametrize("reader", [Reader1, Reader2])
@given(st.lists(TRICKY | st.binary(max_size=300), max_size=20))
def test_reader_accepts_any_bytes(reader, chunks):
    stream_reader = reader()
    for chunk in chunks:
        for status in stream_reader.feed(chunk):
            assert 0 <= status.number <= 255
        assert len(stream_reader._buffer) <= MAX_BUFFER


@given(st.binary(min_size=15, max_size=15), st.integers(0, 25), st.integers(1, 255))
def test_damaged_answer_is_dropped(data, place, change):
    packet = bytearray(status2(1, 0, data))
    packet[place % len(packet)] ^= change
    assert Status(1, 0, data) not in Reader2().feed(bytes(packet))


@given(st.lists(NUMBERS, min_size=1, max_size=8, unique=True), st.integers(1, 30), st.data())
def test_fast_answer_is_split_by_servo(numbers, size, data):
    parts = {n: data.draw(st.binary(min_size=size, max_size=size)) for n in numbers}
    blocks = b"".join(bytes((0, n)) + part + b"\xaa\xbb" for n, part in parts.items())[:-2]
    answer = Status(0xFE, blocks[0], blocks[1:])
    split = split_fast(answer, tuple(numbers), size)
    assert split is not None
    assert {n: status.data for n, status in split.items()} == parts
    assert split_fast(answer, (*numbers, 253), size) is None


@given(st.binary(max_size=80), st.lists(NUMBERS, max_size=6).map(tuple), st.integers(0, 30))
def test_any_fast_answer_is_split_or_refused(body, numbers, size):
    split = split_fast(Status(0xFE, 0, body), numbers, size)
    assert split is None or split.keys() == set(numbers)
