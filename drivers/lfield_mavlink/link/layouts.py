"""Packets to messages and back, by pymavlink's own tables of its dialect.

pymavlink's `decode` and `pack` do the same, but copy the bytes again and again, and work out anew for each
packet where its fields are: most of what it costs to hear a vehicle. What is signed is left to them.
"""

from __future__ import annotations

import struct
from itertools import accumulate
from operator import attrgetter
from typing import Any

from pymavlink.generator.mavcrc import x25crc

MARKER = b"\xfd"
#: What follows the marker: length, two kinds of flags, sequence, system, component, and the kind's 24 bits.
_HEAD = struct.Struct("<BBBBBBHB")
#: Bytes before and after the payload of an unsigned packet of MAVLink 2.
HEADER, CHECKSUM = 10, 2
SHORTEST = HEADER + CHECKSUM


class Layout:
    """Where the fields of one kind of message, a class of the dialect, are in its payload."""

    def __init__(self, kind: Any) -> None:
        self._kind, self._unpacker, self._extra = kind, kind.unpacker, bytes([kind.crc_extra])
        # On the wire fields are sorted by size; an array is as many values, but a text is one.
        starts = list(accumulate(kind.lengths, initial=0))
        self._spans = [(starts[place], kind.lengths[place]) for place in kind.orders]
        self._has_texts = "char" in kind.fieldtypes
        #: Whether it has numbers alone, as commands, setpoints and heartbeats do: what `packet` can make.
        self.is_plain = len(kind.lengths) > 1 and not any(kind.array_lengths)
        self._numbers = attrgetter(*kind.ordered_fieldnames)

    def message(self, packet: bytes) -> Any | None:
        """The message in a whole, unsigned packet; None when its checksum is wrong."""
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
        """A message of numbers alone as an unsigned packet."""
        # Zeros at the end are not sent, but for the first byte.
        payload = self._unpacker.pack(*self._numbers(message)).rstrip(b"\0") or b"\0"
        number = self._kind.id
        head = _HEAD.pack(len(payload), 0, 0, sequence, system, component, number & 0xFFFF, number >> 16)
        body = head + payload
        crc: int = x25crc(body + self._extra).crc
        return MARKER + body + crc.to_bytes(CHECKSUM, "little")

    def _fields(self, payload: bytes) -> list[Any]:
        # Zeros at the end are not sent; what a newer dialect has added is not read.
        values = self._unpacker.unpack_from(payload.ljust(self._unpacker.size, b"\0"))
        fields = [
            values[start] if length == 1 else list(values[start : start + length])
            for start, length in self._spans
        ]
        if self._has_texts:
            return [field.rstrip(b"\0") if isinstance(field, bytes) else field for field in fields]
        return fields
