"""Length-prefixed frames: the only framing of messages, between hosts and to drivers.

    +----------------+--------+---------------------+
    | length, 4 B BE | kind   | payload             |
    +----------------+--------+---------------------+
                     |<------- length bytes ------->|

The length of every kind is checked before any byte of its payload is stored, so a peer can make a reader
store at most one payload of the largest kind.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from lfield.errors import WireError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

#: Byte buffers. A memoryview must have the format 'B'.
Buffer = bytes | bytearray | memoryview

#: The length of the rest, and the kind of the frame.
FRAME_HEADER = struct.Struct(">IB")

#: Bytes before the payload: the length and the kind.
HEADER_SIZE = FRAME_HEADER.size


def frame_header(kind: int, length: int) -> bytes:
    """The bytes before a payload of `length` bytes."""
    return FRAME_HEADER.pack(length + 1, kind)


def frame(kind: int, payload: Buffer) -> bytes:
    """A whole frame, for one write."""
    return b"".join((FRAME_HEADER.pack(len(payload) + 1, kind), payload))


def size_of(start: Buffer, longest: int) -> int:
    """The size in bytes of the first frame of a stream, header included; the size of the header while the
    header is incomplete.

    This function is for a reader that must not read beyond one frame. For a payload over `longest` it returns
    no more than `longest`.
    """
    if len(start) < HEADER_SIZE:
        return HEADER_SIZE
    length: int = FRAME_HEADER.unpack_from(start)[0]
    return HEADER_SIZE + min(max(0, length - 1), longest)


class FrameDecoder:
    """Splits a stream of bytes, fed in pieces of any size, into frames.

    `limits` is the largest payload of every accepted kind, in bytes. A frame of another kind, or one that is
    too long, is a WireError: the stream cannot be read any further. For the kinds in `skippable`, an
    oversized frame is discarded as it arrives; then `on_skipped` is called with the kind, the length, and as
    many of the first payload bytes as `skippable` says, so that the reader can send a refusal.
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
        #: The number of discarded bytes of oversize frames since `reset_skipped`.
        self.skipped = 0

    def set_limits(self, limits: Mapping[int, int]) -> None:
        """Replace the limits; call it between two frames."""
        self.limits = limits

    def reset_skipped(self) -> None:
        """Restart the count of discarded bytes."""
        self.skipped = 0

    @property
    def is_mid_frame(self) -> bool:
        """Whether the stream is inside a frame; if it ended now, data would be lost."""
        return self._body is not None or bool(self._start)

    def decode_single_frame(self, data: Buffer) -> tuple[int, memoryview] | None:
        """The kind and payload if the next bytes are exactly one frame; otherwise None.

        One frame is the usual case, which needs no copy.
        """
        size = len(data) - HEADER_SIZE
        if size < 0 or self._body is not None or self._start:
            return None
        length, kind = FRAME_HEADER.unpack_from(data)
        if length - 1 != size or size > self.limits.get(kind, -1):
            return None
        return kind, memoryview(data)[HEADER_SIZE:]

    def next_frame_length(self, data: Buffer) -> int:
        """The number of the next bytes to feed to complete at most one frame: all if they do not complete
        one.
        """
        if self._body is not None:
            return min(self._missing, len(data))
        had = len(self._start)
        if had + len(data) < HEADER_SIZE:
            return len(data)
        length: int = FRAME_HEADER.unpack(bytes(self._start) + data[: HEADER_SIZE - had])[0]
        return min(HEADER_SIZE - had + max(0, length - 1), len(data))

    def feed(self, data: Buffer) -> Iterator[tuple[int, memoryview]]:
        """Process the next bytes and yield each completed frame, as kind and payload.

        A payload is a view: into `data` if the frame is contiguous there, else into separate memory. Exhaust
        the iterator before the next call. Raises WireError if the stream violates the limits, after the
        frames before that position have been yielded.
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
                count = min(HEADER_SIZE - len(self._start), end - position)
                self._start += view[position : position + count]
                position += count
                if len(self._start) < HEADER_SIZE:
                    return
                length, kind = FRAME_HEADER.unpack(self._start)
                self._start.clear()
            else:
                length, kind = FRAME_HEADER.unpack_from(view, position)
                position += HEADER_SIZE
            length -= 1
            if 0 <= length <= end - position and length <= self.limits.get(kind, -1):
                yield kind, view[position : position + length]
                position += length
            else:
                self._start_payload(kind, length)

    def discard_partial(self) -> None:
        """Free the memory of an unfinished frame: the stream has ended."""
        self._body = None

    def _start_payload(self, kind: int, length: int) -> None:
        """Allocate memory for a payload that arrives in pieces, or for the head of an oversized one."""
        limit = self.limits.get(kind)
        if limit is None or length < 0:
            raise WireError(f"the peer does not speak lfield: a frame of kind {kind} and length {length + 1}")
        stored = length
        if length > limit:
            if kind not in self._skippable:
                raise WireError(f"a frame of kind {kind} has {length} bytes; at most {limit} are allowed")
            stored = self._skippable[kind]
        self._kind, self._length = kind, length
        self._body, self._filled, self._missing = bytearray(min(stored, length)), 0, length

    def _collect(self, view: memoryview, position: int) -> int:
        """Copy the needed part of the next bytes into the body; returns the position after the bytes used."""
        assert self._body is not None
        used = min(self._missing, len(view) - position)
        count = min(used, len(self._body) - self._filled)
        self._body[self._filled : self._filled + count] = view[position : position + count]
        self._filled += count
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
