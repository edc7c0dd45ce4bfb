"""The fields of an IP packet: destination, service and sizes."""

from __future__ import annotations

import struct
from typing import NamedTuple

TCP, UDP = 6, 17
_PORTS = struct.Struct("!HH")
_V6_HEADER = 40


class Header(NamedTuple):
    """`to` is the packed destination, `port` the lower of both (0: has none), sizes in bytes."""

    to: bytes
    protocol: int
    port: int
    size: int
    payload: int


def read_header(packet: bytes) -> Header | None:
    """The header of an IPv4 or IPv6 packet; None for one that is cut off or of another kind.

    RFC 791, RFC 8200, RFC 9293, RFC 768. The payload follows the TCP or UDP header.
    """
    version = packet[0] >> 4 if packet else 0
    if version == 4 and len(packet) >= 20:
        head, protocol, to = (packet[0] & 15) * 4, packet[9], packet[16:20]
    elif version == 6 and len(packet) >= _V6_HEADER:
        head, protocol, to = _V6_HEADER, packet[6], packet[24:40]
    else:
        return None
    port, payload = 0, len(packet) - head
    least = {TCP: 20, UDP: 8}.get(protocol)
    if least is not None and payload >= least:
        port = min(_PORTS.unpack_from(packet, head))
        payload -= (packet[head + 12] >> 4) * 4 if protocol == TCP else least
    return Header(to, protocol, port, len(packet), max(0, payload))
