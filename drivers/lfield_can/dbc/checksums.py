"""Checksums of CAN messages, by the names that bindings use. Pure.

AUTOSAR: E2E Protocol Specification, profiles 1 (data id mode "both"), 2 and 5, whose CRCs are in the
specification of CRC routines. The last two are checksums of car makers, as in opendbc.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, reduce
from operator import xor

from msgspec import Struct


class Covered(Struct, frozen=True):
    """The data that a checksum covers: the id of the frame, its `data` with the bits of the checksum 0, the
    `rest` of it without the bytes of the checksum, the data ids of the binding, and the counter.
    """

    identifier: int
    extended: bool
    data: bytes
    rest: bytes
    ids: Sequence[int] = ()
    counter: int = 0


class ChecksumKind(Struct, frozen=True):
    """A checksum of `bits` bits that needs `ids` data ids, each at most `highest`."""

    value: Callable[[Covered], int]
    bits: int = 8
    ids: int = 0
    highest: int = 0


@cache
def _table(polynomial: int, width: int) -> tuple[int, ...]:
    entries = []
    for byte in range(256):
        value = byte << width - 8
        for _ in range(8):
            value = value << 1 ^ (polynomial if value >> width - 1 else 0)
            value &= (1 << width) - 1
        entries.append(value)
    return tuple(entries)


def crc(data: bytes, polynomial: int, initial: int, *, width: int = 8) -> int:
    """A CRC, not reflected, without final XOR."""
    table, mask = _table(polynomial, width), (1 << width) - 1
    value = initial
    for byte in data:
        value = value << 8 & mask ^ table[value >> width - 8 ^ byte]
    return value


def _e2e_1(covered: Covered) -> int:
    return crc(covered.ids[0].to_bytes(2, "little") + covered.rest, 0x1D, 0)


def _e2e_2(covered: Covered) -> int:
    return crc(covered.rest + bytes([covered.ids[covered.counter % 16]]), 0x2F, 0xFF) ^ 0xFF


def _e2e_5(covered: Covered) -> int:
    return crc(covered.rest + covered.ids[0].to_bytes(2, "little"), 0x1021, 0xFFFF, width=16)


def _nibbles(data: bytes) -> int:
    return sum((byte >> 4) + (byte & 0xF) for byte in data)


def _honda(covered: Covered) -> int:
    content = covered.identifier.to_bytes(4, "big") + covered.data
    return 8 + 3 * covered.extended - _nibbles(content) & 0xF


def _toyota(covered: Covered) -> int:
    return sum(covered.identifier.to_bytes(4, "big") + covered.rest) + len(covered.data) & 0xFF


KINDS: Mapping[str, ChecksumKind] = {
    "xor8": ChecksumKind(lambda covered: reduce(xor, covered.rest, 0)),
    "sum8": ChecksumKind(lambda covered: sum(covered.rest) & 0xFF),
    "crc8_j1850": ChecksumKind(lambda covered: crc(covered.rest, 0x1D, 0xFF) ^ 0xFF),
    "crc8_h2f": ChecksumKind(lambda covered: crc(covered.rest, 0x2F, 0xFF) ^ 0xFF),
    "e2e_1": ChecksumKind(_e2e_1, ids=1, highest=0xFFFF),
    "e2e_2": ChecksumKind(_e2e_2, ids=16, highest=0xFF),
    "e2e_5": ChecksumKind(_e2e_5, bits=16, ids=1, highest=0xFFFF),
    "honda": ChecksumKind(_honda, bits=4),
    "toyota": ChecksumKind(_toyota),
}
