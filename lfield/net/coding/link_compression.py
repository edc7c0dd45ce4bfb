"""Compresses the messages of a link in the context of earlier ones: deflate streams (RFC 1951). Sans-IO.

Each message ends at a byte boundary (sync flush), and the constant end of the flush is not sent, as in RFC
7692. So a report that repeats the previous one costs a few bytes. Both ends process the messages of one
direction in order.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

from lfield.errors import WireError

if TYPE_CHECKING:
    from lfield.wire.framing import Buffer

#: Context of a link in bytes as a power of two, and the memory and compression levels: 48 kB for sending.
_WINDOW, _MEMORY, _LEVEL = 13, 5, 4
#: The constant end of a sync flush.
_FLUSHED = b"\x00\x00\xff\xff"


class LinkCompression:
    """The two streams of one link."""

    def __init__(self) -> None:
        self._out = zlib.compressobj(_LEVEL, zlib.DEFLATED, -_WINDOW, _MEMORY)
        self._in = zlib.decompressobj(-_WINDOW)

    def encode(self, body: Buffer) -> bytes:
        """Compress the next message to send."""
        data = self._out.compress(body) + self._out.flush(zlib.Z_SYNC_FLUSH)
        return data[: -len(_FLUSHED)]

    def decode(self, payload: Buffer, longest: int) -> bytes:
        """Expand the next message that arrived, of at most `longest` bytes. Raises WireError."""
        try:
            body = self._in.decompress(bytes(payload) + _FLUSHED, longest)
        except zlib.error as error:
            raise WireError(f"a message cannot be expanded: {error}") from None
        if self._in.unconsumed_tail or self._in.eof:
            raise WireError(f"a message expands to over {longest} bytes, or ends its stream")
        return body
