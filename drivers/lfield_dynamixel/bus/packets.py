"""Packets of DYNAMIXEL protocols 2.0 and 1.0, and of Feetech's, which are those of 1.0: bytes in, bytes out.

https://emanual.robotis.com/docs/en/dxl/protocol2/ and .../protocol1/. A packet of protocol 2.0 is `FF FF FD
00 id length(2) instruction parameters... crc(2)`; `FF FF FD` in its body is stuffed with another FD. A packet
of protocol 1.0 is `FF FF id length instruction parameters... checksum`. An answer is a *status packet*: in
2.0 its instruction is 55 and an error byte follows; in 1.0 the error byte replaces the instruction.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

from dynamixel_sdk.robotis_def import BROADCAST_ID, INST_STATUS, INST_SYNC_WRITE, MAX_ID
from msgspec import Struct

#: A longer status packet is noise (the SDK's own bound).
MAX_PACKET_LENGTH = 1024
#: Bytes kept of an incomplete packet.
MAX_BUFFER = MAX_PACKET_LENGTH + 7

#: Packets whose echo may be pending; a packet without answer does not wait for its own.
MAX_PENDING_ECHOES = 8

_HEADER = b"\xff\xff\xfd"


class Status(Struct, frozen=True):
    """A status packet: id, error byte and data."""

    number: int
    error: int
    data: bytes


class Reader(Protocol):
    """Finds status packets in a stream of bytes."""

    def feed(self, data: bytes) -> list[Status]:
        """The packets that are now complete. Skips noise; raises nothing."""


def _crc_table() -> tuple[int, ...]:
    """CRC-16 with the polynomial 8005, as on the protocol's page."""
    table = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    """The checksum of protocol 2.0."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ _CRC[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """A body without a header sequence."""
    return body.replace(_HEADER, _HEADER + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """The inverse of `stuff`."""
    return body.replace(_HEADER + b"\xfd", _HEADER)


class Protocol2:
    """Protocol 2.0."""

    version = 2
    #: Bytes of a status packet in addition to its data.
    overhead = 11

    @staticmethod
    def encode(number: int, instruction: int, parameters: bytes = b"") -> bytes:
        """An instruction packet."""
        body = stuff(bytes((instruction,)) + parameters)
        length = len(body) + 2
        packet = _HEADER + bytes((0, number, length & 0xFF, length >> 8)) + body
        return packet + crc16(packet).to_bytes(2, "little")

    @staticmethod
    def reader() -> Reader:
        return Reader2()


class Reader2:
    """Status packets of protocol 2.0. A fast sync read is answered by one packet of the broadcast id."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Status]:
        """The packets that are now complete."""
        buffer, at, packets = self._buffer + data, 0, []
        while True:
            at = buffer.find(_HEADER, at)
            if at < 0 or len(buffer) < at + 7:
                break
            length = buffer[at + 5] | buffer[at + 6] << 8
            if buffer[at + 3] != 0 or not 4 <= length <= MAX_PACKET_LENGTH:
                at += 3
                continue
            end = at + 7 + length
            if len(buffer) < end:
                break
            status = _status2(buffer[at:end])
            if status is not None:
                packets.append(status)
            # An invalid packet may be a header in noise: the next one may start within it.
            at = end if status is not None else at + 3
        # Two bytes may be part of a header.
        self._buffer = (buffer[at:] if at >= 0 else buffer[-2:])[-MAX_BUFFER:]
        return packets


def _status2(packet: bytes) -> Status | None:
    """The status of a packet; None if it is damaged, or an instruction (an echo)."""
    if packet[7] != INST_STATUS or crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
        return None
    # The parts of a fast answer come from several servos and are not stuffed (as in the SDK).
    body = packet[8:-2] if packet[4] == BROADCAST_ID else unstuff(packet[7:-2])[1:]
    return Status(packet[4], body[0], body[1:]) if body else None


def split_fast(answer: Status, numbers: tuple[int, ...], size: int) -> dict[int, Status] | None:
    """The parts `error id data crc` of the answer to a fast sync read, by id; None if incomplete.

    The checksum of the packet covers all parts, so the checksums between them are not checked.
    """
    body = bytes((answer.error,)) + answer.data + b"\0\0"
    part = size + 4
    if len(body) != part * len(numbers):
        return None
    pieces = [body[at : at + part] for at in range(0, len(body), part)]
    parts = {piece[1]: Status(piece[1], piece[0], piece[2:-2]) for piece in pieces}
    return parts if parts.keys() == set(numbers) else None


class Protocol1:
    """Protocol 1.0, of AX and older MX servos, and of Feetech."""

    version = 1
    overhead = 6

    @staticmethod
    def encode(number: int, instruction: int, parameters: bytes = b"") -> bytes:
        """An instruction packet; at most 250 parameters."""
        body = bytes((number, len(parameters) + 2, instruction)) + parameters
        return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))

    @staticmethod
    def reader() -> Reader:
        return Reader1()


class Reader1:
    """Status packets of protocol 1.0."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Status]:
        """The packets that are now complete."""
        buffer, at, packets = self._buffer + data, 0, []
        while True:
            at = buffer.find(b"\xff\xff", at)
            if at < 0 or len(buffer) < at + 4:
                break
            end = at + 4 + buffer[at + 3]
            if buffer[at + 2] > MAX_ID or buffer[at + 3] < 2:
                at += 1
                continue
            if len(buffer) < end:
                break
            is_valid = sum(buffer[at + 2 : end]) & 0xFF == 0xFF
            if is_valid:
                packets.append(Status(buffer[at + 2], buffer[at + 4], buffer[at + 5 : end - 1]))
            at = end if is_valid else at + 1
        self._buffer = (buffer[at:] if at >= 0 else buffer[-1:])[-MAX_BUFFER:]
        return packets


#: Either protocol: both have `version`, `overhead`, `encode` and `reader`.
AnyProtocol = type[Protocol1] | type[Protocol2]
#: By the number in a binding; 0 is Feetech's, as in the vendor's SDK.
PROTOCOLS: dict[int, AnyProtocol] = {0: Protocol1, 1: Protocol1, 2: Protocol2}


def harmless(protocol: AnyProtocol) -> bytes:
    """A packet without effect and answer: a sync write to no servo."""
    return protocol.encode(BROADCAST_ID, INST_SYNC_WRITE, bytes(4 if protocol.version == 2 else 2))


class EchoFilter:
    """Removes echoes of sent packets from received data.

    Some adapters keep receiving while they send. In protocol 1.0 an instruction looks like an answer: the
    ping of servo 1 equals its answer with a voltage error. A damaged echo is passed on: its checksum is
    wrong, so the reader treats it as noise.
    """

    def __init__(self) -> None:
        self._pending_echoes: deque[bytes] = deque(maxlen=MAX_PENDING_ECHOES)
        self._buffer = b""

    def on_sent(self, packet: bytes) -> None:
        self._pending_echoes.append(packet)

    def strip(self, data: bytes) -> bytes:
        """The received bytes without echoes; a partial echo is held back until it is complete."""
        self._buffer += data
        output = b""
        while self._pending_echoes:
            echo = self._pending_echoes[0]
            if (at := self._buffer.find(echo)) >= 0:
                # Bytes before it are noise, or a damaged echo.
                output += self._buffer[:at]
                self._buffer = self._buffer[at + len(echo) :]
            elif len(self._buffer) < len(echo):
                return output
            self._pending_echoes.popleft()
        output, self._buffer = output + self._buffer, b""
        return output
