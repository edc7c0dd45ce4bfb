"""Kernel packet filter (classic BPF, `SO_ATTACH_FILTER`, Linux): a dropped datagram costs the host no CPU
time.

The filter drops datagrams that cannot be orders by size and first bytes. For a while it also drops all
datagrams of senders that exceed the limit. Without it a flood fills the socket buffer and displaces orders.
Kernels without filters deliver all datagrams; the rate limits still apply.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable
from typing import NamedTuple

from lfield.wire.order_messages import MAGIC, MAX_DATAGRAM

#: Size of the shortest datagram that may be an order, in bytes: a signature and its envelope.
SHORTEST = 120
#: Maximum number of senders dropped at a time, and the duration in seconds.
MAX_FLOODERS, DROP_SECONDS = 32, 2.0

_SO_ATTACH_FILTER = 26
#: Opcodes: load a word, half word or byte at an offset, or the size; and; jump if equal, greater or equal, or
#: greater; return.
_LD, _LDH, _LDB, _LEN, _AND, _JEQ, _JGE, _JGT, _RET = 0x20, 0x28, 0x30, 0x80, 0x54, 0x15, 0x35, 0x25, 0x06
#: Offset of the IP header for loads, and the size of the UDP header, in bytes.
_NET, _UDP = 0xFFF00000, 8
_ALL, _NONE = 0xFFFFFFFF, 0
#: The port of a `Flooder` that stands for all ports of its address.
ANY_PORT = 0


class Flooder(NamedTuple):
    """A sender that exceeds the limit: packed address (4 or 16 bytes), and port or ANY_PORT."""

    address: bytes
    port: int


def flooder_at(host: str, port: int) -> Flooder:
    """A sender by its socket address. Raises OSError."""
    host = host.partition("%")[0]
    if ":" not in host:
        return Flooder(socket.inet_pton(socket.AF_INET, host), port)
    packed = socket.inet_pton(socket.AF_INET6, host)
    is_mapped = packed.startswith(bytes(10) + b"\xff\xff")
    return Flooder(packed[12:] if is_mapped else packed, port)


def attach(receiving: socket.socket, flooders: Iterable[Flooder]) -> bool:
    """Attach a filter against non-orders and these senders. Returns whether the kernel accepted it."""
    # Imported here, so that a command that opens no port starts sooner.
    import ctypes

    code = program(flooders)
    buffer = ctypes.create_string_buffer(code)
    sock_fprog = struct.pack("HL", len(code) // 8, ctypes.addressof(buffer))
    try:
        receiving.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, sock_fprog)
    except OSError:
        return False
    return True


def program(flooders: Iterable[Flooder]) -> bytes:
    """The BPF program. The program compares the last 32 bits of an IPv6 address."""
    dropped = list(flooders)[:MAX_FLOODERS]
    ipv4_code = _senders([flooder for flooder in dropped if len(flooder.address) == 4], _NET + 12)
    ipv6_code = _senders([flooder for flooder in dropped if len(flooder.address) == 16], _NET + 20)
    code = [
        (_LD, 0, 0, _UDP),
        (_JEQ, 1, 0, int.from_bytes(MAGIC)),
        (_RET, 0, 0, _NONE),
        (_LEN, 0, 0, 0),
        (_JGE, 1, 0, SHORTEST + _UDP),
        (_RET, 0, 0, _NONE),
        (_JGT, 0, 1, MAX_DATAGRAM + _UDP),
        (_RET, 0, 0, _NONE),
        (_LDB, 0, 0, _NET),
        (_AND, 0, 0, 0xF0),
        (_JEQ, 0, len(ipv6_code), 0x60),
        *ipv6_code,
        *ipv4_code,
    ]
    return b"".join(struct.pack("=HBBI", *line) for line in code)


def _senders(senders: list[Flooder], offset: int) -> list[tuple[int, int, int, int]]:
    """Instructions that drop these senders, with addresses at an offset, and accept all others."""
    code = []
    for sender in senders:
        ip_bits = int.from_bytes(sender.address[-4:])
        port = [] if sender.port == ANY_PORT else [(_LDH, 0, 0, 0), (_JEQ, 0, 1, sender.port)]
        code += [(_LD, 0, 0, offset), (_JEQ, 0, len(port) + 1, ip_bits), *port, (_RET, 0, 0, _NONE)]
    return [*code, (_RET, 0, 0, _ALL)]
