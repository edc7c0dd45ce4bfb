"""Packets of a numbered stream: one publication each.

| bytes | field |
|---|---|
| 1 | kind |
| 4 | number of a numbered packet; that of a question, repeated in its answer; else 0 |
| 4 | number of the next packet that the sender expects: it has received all before |
| 2 | how many of those it has not read yet |
| rest | data |
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

_HEADER = struct.Struct(">BIIH")
#: Bytes before the data, and the largest number of a packet.
HEADER_SIZE, MAX_NUMBER = _HEADER.size, 0xFFFFFFFF


class Kind(IntEnum):
    """The kinds of packets. DATA and FIN are numbered, and repeated until they are acknowledged. PROBE asks
    for the packets that have arrived, and ANSWER reports them.
    """

    OPEN = 1
    ACCEPT = 2
    DATA = 3
    FIN = 4
    ACK = 5
    PROBE = 6
    ANSWER = 7
    RESET = 8


_KINDS = {int(kind): kind for kind in Kind}


class Packet(NamedTuple):
    """A packet: `number`, `expected` and `unread` as in the table of this module."""

    kind: Kind
    number: int
    expected: int
    unread: int
    data: bytes

    def encode(self) -> bytes:
        """The bytes of the publication."""
        return _HEADER.pack(self.kind, self.number, self.expected, self.unread) + self.data


def decode_packet(data: bytes) -> Packet | None:
    """The packet in a publication; None if it is malformed; such a packet counts as lost."""
    if len(data) < HEADER_SIZE:
        return None
    kind, number, expected, unread = _HEADER.unpack_from(data)
    known = _KINDS.get(kind)
    if known is None or unread > expected or (known is not Kind.DATA and len(data) > HEADER_SIZE):
        return None
    return Packet(known, number, expected, unread, data[HEADER_SIZE:])
