"""Deltas between two versions of a byte string: raw deflate (RFC 1951) with the old version as dictionary.

A long string is encoded in chunks. The dictionary of a chunk is the same part of the old version with a
margin at both ends, because deflate finds matches at most 32 KiB back.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

from lfield.errors import WireError

if TYPE_CHECKING:
    from lfield.wire.framing import Buffer

#: The bytes of a chunk, and how far the dictionary extends beyond it at each end. Unmoved bytes match at a
#: distance of CHUNK + MARGIN; bytes that moved by less than MARGIN are found as well.
CHUNK, MARGIN = 12 << 10, 8 << 10
#: The largest window of deflate, and the smallest that zlib accepts for raw streams, as powers of two.
_MAX_WINDOW, _MIN_WINDOW = 15, 10
#: Compression level; and memory levels: a small hash table is initialised in a few microseconds instead of
#: 40, and a large one finds the matches in a large dictionary.
_LEVEL, _SMALL, _LARGE = 6, 4, 8


def encode_delta(new: Buffer, old: Buffer) -> bytes:
    """The delta from which `expand_delta` restores `new`, given the same `old`."""
    whole, base = memoryview(new), memoryview(old)
    chunks: list[bytes] = []
    for start in range(0, len(whole), CHUNK):
        dictionary = _dictionary(base, start)
        window = min(_MAX_WINDOW, max(_MIN_WINDOW, (2 * len(dictionary)).bit_length()))
        memory = _SMALL if window < _MAX_WINDOW else _LARGE
        coder = zlib.compressobj(_LEVEL, zlib.DEFLATED, -window, memory, zlib.Z_DEFAULT_STRATEGY, dictionary)
        chunks += coder.compress(whole[start : start + CHUNK]), coder.flush()
    return b"".join(chunks)


def expand_delta(delta: Buffer, old: Buffer, size: int) -> bytes:
    """The first `size` bytes of the string that a delta describes.

    Expands at most CHUNK bytes more than it returns, also for a malicious delta. Raises WireError if the
    delta is malformed or has fewer bytes.
    """
    base, chunks, length = memoryview(old), list[bytes](), 0
    remaining: Buffer = delta
    while length < size:
        coder = zlib.decompressobj(-_MAX_WINDOW, _dictionary(base, length))
        try:
            chunk = coder.decompress(remaining, CHUNK)
            # The end of a full chunk may not have been read yet.
            excess = b"" if coder.eof else coder.decompress(coder.unconsumed_tail, 1)
        except zlib.error as error:
            raise WireError(f"a delta is malformed: {error}") from None
        if not chunk or excess or not coder.eof:
            raise WireError("a delta is cut, or one of its chunks is too long")
        chunks.append(chunk)
        length += len(chunk)
        remaining = coder.unused_data
    return b"".join(chunks)[:size]


def _dictionary(old: memoryview, start: int) -> memoryview:
    """The part of the old version that may be referred to by the chunk at `start`."""
    return old[max(0, start - MARGIN) : start + CHUNK + MARGIN]
