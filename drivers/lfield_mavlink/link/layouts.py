"""Fast encoding and decoding of unsigned packets, with pymavlink's tables.

pymavlink's `decode` and `pack` copy the bytes several times and compute field offsets for each packet, which
is most of the cost of receiving. Signed packets are left to them.
"""

from __future__ import annotations

import struct
from itertools import accumulate
from operator import attrgetter
from typing import Any

from pymavlink.generator.mavcrc import x25crc

MARKER = b"\xfd"
#: After the marker: length, two flag bytes, sequence, system, component, and the 24-bit message id.
_HEAD = struct.Struct("<BBBBBBHB")
#: Bytes before and after the payload of an unsigned MAVLink 2 packet.
HEADER, CHECKSUM = 10, 2
SHORTEST = HEADER + CHECKSUM


class Layout:
    """Offsets of the fields of one message class of the dialect."""

    def __init__(self, kind: Any) -> None:
        self._kind, self._unpacker, self._extra = kind, kind.unpacker, bytes([kind.crc_extra])
        # On the wire fields are sorted by size; an array has several values, a text is one.
        starts = list(accumulate(kind.lengths, initial=0))
        self._spans = [(starts[place], kind.lengths[place]) for place in kind.orders]
        self._has_texts = "char" in kind.fieldtypes
        #: Whether all fields are numbers, as in commands, setpoints and heartbeats: required by `packet`.
        self.is_plain = len(kind.lengths) > 1 and not any(kind.array_lengths)
        self._numbers = attrgetter(*kind.ordered_fieldnames)

    def message(self, packet: bytes) -> Any | None:
        """The message of a whole, unsigned packet; None for a wrong checksum."""
        end = len(packet) - CHECKSUM
        crc = x25crc(packet[1:end] + self._extra).crc
        if crc != packet[end] | packet[end + 1] << 8:
            return None
        message = self._kind(*self._fields(packet[HEADER:end]))
        header = message.get_header()
        header.mlen, header.seq, header.srcSystem, header.srcComponent = packet[1], *packet[4:7]
        message.get_msgbuf().extend(packet)
        return message

    def packet(self, message: Any, sequence: int, system: int, component: int) -> bytes:
        """Packs a message of numbers as an unsigned packet."""
        # Trailing zeros are not sent, except for the first byte.
        payload = self._unpacker.pack(*self._numbers(message)).rstrip(b"\0") or b"\0"
        number = self._kind.id
        head = _HEAD.pack(len(payload), 0, 0, sequence, system, component, number & 0xFFFF, number >> 16)
        body = head + payload
        crc: int = x25crc(body + self._extra).crc
        return MARKER + body + crc.to_bytes(CHECKSUM, "little")

    def _fields(self, payload: bytes) -> list[Any]:
        # Trailing zeros are not sent; fields added by a newer dialect are ignored.
        values = self._unpacker.unpack_from(payload.ljust(self._unpacker.size, b"\0"))
        fields = [
            values[start] if length == 1 else list(values[start : start + length])
            for start, length in self._spans
        ]
        if self._has_texts:
            return [field.rstrip(b"\0") if isinstance(field, bytes) else field for field in fields]
        return fields
