"""Splits a bundle at places that depend on its contents, so that versions share most pieces. Pure.

The cut points are those of a gear hash (as in FastCDC): a changed byte changes the piece that contains it and
at most the next one.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from hashlib import sha256
from typing import NamedTuple

from lfield.errors import WireError
from lfield.wire.service_messages import MAX_PIECE, PIECE_DIGEST_SIZE

#: Shortest piece, and the mask whose bits must be 0 at a cut: pieces have about 1 KiB on average.
MIN_PIECE, _MASK = 256, 0x3FF << 20
_MASK32 = (1 << 32) - 1
_GEAR = [int.from_bytes(sha256(bytes([n])).digest()[:4]) for n in range(256)]


class Piece(NamedTuple):
    """The digest and the size in bytes of a piece."""

    digest: bytes
    size: int


def split(data: bytes) -> Iterator[bytes]:
    """The pieces of some bytes, in order."""
    start = 0
    while start < len(data):
        end = _cut(data, start)
        yield data[start:end]
        start = end


def _cut(data: bytes, start: int) -> int:
    """The end of the piece that begins at `start`."""
    last = min(start + MAX_PIECE, len(data))
    hash = 0
    for at in range(min(start + MIN_PIECE, last), last):
        hash = (hash << 1) + _GEAR[data[at]] & _MASK32
        if not hash & _MASK:
            return at + 1
    return last


def piece_of(data: bytes) -> Piece:
    """Digest and size of the bytes of a piece."""
    return Piece(sha256(data).digest()[:PIECE_DIGEST_SIZE], len(data))


def compress(data: bytes) -> tuple[bool, bytes]:
    """The bytes as they are sent, and whether they are compressed."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = packer.compress(data) + packer.flush()
    return (True, packed) if len(packed) < len(data) else (False, data)


def decompress(data: bytes, *, is_compressed: bool) -> bytes:
    """The bytes of a received piece, at most `MAX_PIECE`. Raises WireError."""
    if not is_compressed:
        return data
    unpacker = zlib.decompressobj(-15)
    try:
        found = unpacker.decompress(data, MAX_PIECE)
    except zlib.error as error:
        raise WireError(f"a piece of a bundle cannot be decompressed: {error}") from None
    if not unpacker.eof:
        raise WireError(f"a piece of a bundle is larger than {MAX_PIECE} bytes or truncated")
    return found
