"""Dynamixel packets, protocols 2.0 and 1.0: instructions in, answers out.

https://emanual.robotis.com/docs/en/dxl/protocol2/ and .../protocol1/.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Protocol

from msgspec import Struct

BROADCAST = 0xFE
#: The longest accepted packet in bytes; a larger length is noise.
MAX_PACKET = 1024

HEADER = b"\xff\xff\xfd\x00"
_STATUS = 0x55
_LEAD = b"\xff\xff\xfd"
_STUFFED = b"\xff\xff\xfd\xfd"


class Instruction(IntEnum):
    """The known instructions."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class InstructionPacket(Struct, frozen=True):
    """One instruction packet. `is_valid` is False for a wrong checksum; `size` is bytes on the wire."""

    id: int
    instruction: int
    parameters: bytes
    size: int
    is_valid: bool = True


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return table


_CRC = _crc_table()


def crc16(data: Iterable[int], crc: int = 0) -> int:
    """The checksum of protocol 2.0 (polynomial 0x8005), continued from `crc`."""
    for byte in data:
        crc = ((crc & 0xFF) << 8) ^ _CRC[(crc >> 8) ^ byte]
    return crc


def stuff(data: bytes) -> bytes:
    """Escapes headers in `data`: FF FF FD becomes FF FF FD FD."""
    return data.replace(_LEAD, _STUFFED)


def unstuff(data: bytes) -> bytes:
    """The inverse of `stuff`."""
    return data.replace(_STUFFED, _LEAD)


def encode(id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """An instruction packet of protocol 2.0."""
    return _sealed(id, stuff(bytes([instruction]) + parameters))


def _sealed(id: int, body: bytes) -> bytes:
    packet = HEADER + bytes([id]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


class Codec(Protocol):
    """One protocol: bytes to packets, and answers to bytes."""

    def feed(self, data: bytes) -> list[InstructionPacket]:
        """The packets that these bytes complete; others are skipped. Never raises."""

    def clear(self) -> None:
        """Discards a partial packet."""

    def status(self, id: int, error: int, data: bytes = b"") -> bytes:
        """A status packet."""


class Codec2:
    """Protocol 2.0."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[InstructionPacket]:
        """The packets that these bytes complete."""
        buffer = self._buffer
        packets: list[InstructionPacket] = []
        buffer += data
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                # The last bytes may be part of a header.
                del buffer[: max(0, len(buffer) - len(HEADER) + 1)]
                return packets
            del buffer[:start]
            if len(buffer) < 7:
                return packets
            end = 7 + int.from_bytes(buffer[5:7], "little")
            if not 10 <= end <= MAX_PACKET:
                del buffer[: len(HEADER)]
            elif len(buffer) >= end:
                packets.append(self._next_packet(end))
            elif not self._restart():
                return packets

    def _next_packet(self, end: int) -> InstructionPacket:
        raw = bytes(self._buffer[:end])
        is_valid = crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")
        # The length of the packet may be wrong too, so the search continues right after its header.
        del self._buffer[: end if is_valid else len(HEADER)]
        return InstructionPacket(raw[4], raw[7], unstuff(raw[7:-2])[1:], end, is_valid)

    def _restart(self) -> bool:
        """Whether another packet has started inside a partial one."""
        start = self._buffer.find(HEADER, len(HEADER))
        if start >= 0:
            del self._buffer[:start]
        return start >= 0

    def clear(self) -> None:
        """Discards a partial packet."""
        self._buffer.clear()

    def status(self, id: int, error: int, data: bytes = b"") -> bytes:
        """A status packet, stuffed."""
        return _sealed(id, stuff(bytes([_STATUS, error]) + data))


def fast_status(expected: int, blocks: Sequence[tuple[int, int, bytes]]) -> bytes:
    """The shared packet of all servos in a fast read.

    `expected` is the size of all blocks if every servo answered; `blocks` are id, error and data of those
    that did. Each block ends with the checksum of everything before it. Nothing is stuffed: the vendor's
    software finds the blocks by their length.
    """
    packet = HEADER + bytes([BROADCAST]) + (expected + 1).to_bytes(2, "little") + bytes([_STATUS])
    for id, error, data in blocks:
        packet += bytes([error, id]) + data
        packet += crc16(packet).to_bytes(2, "little")
    return packet


class Codec1:
    """Protocol 1.0: FF FF, id, length, instruction, parameters, sum."""

    _START = b"\xff\xff"

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[InstructionPacket]:
        """The packets that these bytes complete."""
        buffer = self._buffer
        packets: list[InstructionPacket] = []
        buffer += data
        while True:
            start = buffer.find(self._START)
            if start < 0:
                del buffer[: max(0, len(buffer) - 1)]
                return packets
            del buffer[:start]
            if len(buffer) < 4:
                return packets
            end = 4 + buffer[3]
            if buffer[2] == 0xFF or buffer[3] < 2:
                del buffer[:1]
            elif len(buffer) < end:
                return packets
            else:
                packets.append(self._next_packet(end))

    def _next_packet(self, end: int) -> InstructionPacket:
        raw = bytes(self._buffer[:end])
        is_valid = ~sum(raw[2:-1]) & 0xFF == raw[-1]
        del self._buffer[: end if is_valid else 1]
        return InstructionPacket(raw[2], raw[4], raw[5:-1], end, is_valid)

    def clear(self) -> None:
        """Discards a partial packet."""
        self._buffer.clear()

    def status(self, id: int, error: int, data: bytes = b"") -> bytes:
        """A status packet."""
        return encode1(id, error, data)


def encode1(id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """A packet of protocol 1.0; in answers the error replaces the instruction."""
    body = bytes([id, len(parameters) + 2, instruction]) + parameters
    return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])
