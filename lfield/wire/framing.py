"""Length-prefixed frames: the one way bytes are cut into messages, between hosts and to drivers.

    +----------------+--------+---------------------+
    | length, 4 B BE | kind   | payload             |
    +----------------+--------+---------------------+
                     |<------- length bytes ------->|

The length of every kind is bounded before a byte of its payload is kept, so a peer can make a reader
hold at most one payload of the largest kind it agreed to.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from lfield.errors import WireError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

#: Bytes as a caller may hold them. A memoryview must be one of plain bytes (format 'B').
Buffer = bytes | bytearray | memoryview

_HEADER = struct.Struct(">IB")

#: Bytes before the payload: the length and the kind.
HEADER_SIZE = _HEADER.size


def frame_header(kind: int, length: int) -> bytes:
    """The bytes that go before a payload of `length` bytes."""
    return _HEADER.pack(length + 1, kind)


def frame(kind: int, payload: Buffer) -> bytes:
    """A whole frame in one piece, for one write."""
    return b"".join((_HEADER.pack(len(payload) + 1, kind), payload))


def size_of(start: Buffer, longest: int) -> int:
    """Bytes of the first frame of a stream, its header too: of the header alone while that is not whole.

    For who reads one frame and no byte more; of a payload over `longest` no more than that.
    """
    if len(start) < HEADER_SIZE:
        return HEADER_SIZE
    length: int = _HEADER.unpack_from(start)[0]
    return HEADER_SIZE + min(max(0, length - 1), longest)


class FrameDecoder:
    """Cuts a stream of bytes, fed in pieces of any size, back into frames.

    `limits` gives the largest payload of every kind that may come, in bytes; it may be replaced between
    two frames. A frame of another kind, or one that is too long, is a WireError: the stream cannot be read
    any further. The kinds in `skippable` are milder: an oversize one is thrown away as it arrives, and when
    all of it has passed `on_skipped` is called with the kind, the length, and as many of the first payload
    bytes as `skippable` says, so that the reader can refuse it politely.
    """

    def __init__(
        self,
        limits: Mapping[int, int],
        *,
        skippable: Mapping[int, int] | None = None,
        on_skipped: Callable[[int, int, bytes], None] | None = None,
    ) -> None:
        self.limits = limits
        self._skippable = skippable or {}
        self._on_skipped = on_skipped
        self._start = bytearray()  # a header that arrived in pieces
        self._kind = 0
        self._length = 0
        self._body: bytearray | None = None  # the payload (or the kept head of one) being collected
        self._filled = 0
        self._missing = 0  # payload bytes still to come
        #: How many bytes of oversize frames were thrown away; whoever reads it may set it back to 0.
        self.skipped = 0

    @property
    def unfinished(self) -> bool:
        """Whether the stream stands inside a frame: if it ends now, something is lost."""
        return self._body is not None or bool(self._start)

    def whole(self, data: Buffer) -> tuple[int, memoryview] | None:
        """The kind and payload of a frame that the next bytes are, no more and no less; else None.

        Mostly they are: then nothing has to be fed.
        """
        size = len(data) - HEADER_SIZE
        if size < 0 or self._body is not None or self._start:
            return None
        length, kind = _HEADER.unpack_from(data)
        if length - 1 != size or size > self.limits.get(kind, -1):
            return None
        return kind, memoryview(data)[HEADER_SIZE:]

    def one(self, data: Buffer) -> int:
        """How many of the next bytes to feed so that they complete one frame at most: all, if they do not."""
        if self._body is not None:
            return min(self._missing, len(data))
        had = len(self._start)
        if had + len(data) < HEADER_SIZE:
            return len(data)
        length: int = _HEADER.unpack(bytes(self._start) + data[: HEADER_SIZE - had])[0]
        return min(HEADER_SIZE - had + max(0, length - 1), len(data))

    def feed(self, data: Buffer) -> Iterator[tuple[int, memoryview]]:
        """Take the next bytes and yield each frame they complete, as kind and payload.

        A payload is a view: into `data` where the frame lies in it whole, else into memory of its own.
        Use up the iterator before feeding again. Raises WireError where the stream breaks the limits;
        the frames before that place have been yielded by then.
        """
        view = memoryview(data)
        position, end = 0, len(view)
        while position < end:
            if self._body is not None:
                position = self._collect(view, position)
                if self._missing == 0:
                    yield from self._complete()
                continue
            if self._start or end - position < HEADER_SIZE:
                taken = min(HEADER_SIZE - len(self._start), end - position)
                self._start += view[position : position + taken]
                position += taken
                if len(self._start) < HEADER_SIZE:
                    return
                length, kind = _HEADER.unpack(self._start)
                self._start.clear()
            else:
                length, kind = _HEADER.unpack_from(view, position)
                position += HEADER_SIZE
            length -= 1
            if 0 <= length <= end - position and length <= self.limits.get(kind, -1):
                yield kind, view[position : position + length]
                position += length
            else:
                self._begin(kind, length)

    def forget(self) -> None:
        """Give back the memory of an unfinished frame: nothing more will come."""
        self._body = None

    def _begin(self, kind: int, length: int) -> None:
        """Make room for a payload that does not lie in one piece, or for the head of an oversize one."""
        limit = self.limits.get(kind)
        if limit is None or length < 0:
            raise WireError(f"the peer does not speak lfield: a frame of kind {kind} and length {length + 1}")
        kept = length
        if length > limit:
            if kind not in self._skippable:
                raise WireError(f"a frame of kind {kind} has {length} bytes; at most {limit} are allowed")
            kept = self._skippable[kind]
        self._kind, self._length = kind, length
        self._body, self._filled, self._missing = bytearray(min(kept, length)), 0, length

    def _collect(self, view: memoryview, position: int) -> int:
        """Copy what is wanted of the next bytes into the body; the position after the bytes used."""
        assert self._body is not None
        used = min(self._missing, len(view) - position)
        wanted = min(used, len(self._body) - self._filled)
        self._body[self._filled : self._filled + wanted] = view[position : position + wanted]
        self._filled += wanted
        self._missing -= used
        if self._length > len(self._body):
            self.skipped += used
        return position + used

    def _complete(self) -> Iterator[tuple[int, memoryview]]:
        """Yield the collected frame, or report the skipped one."""
        body, self._body = self._body, None
        assert body is not None
        if self._length <= self.limits[self._kind]:
            yield self._kind, memoryview(body)
        elif self._on_skipped is not None:
            self._on_skipped(self._kind, self._length, bytes(body))
