"""Framing of serial bytes: pure, independent of how the bytes are split, with bounded memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Framer(Protocol):
    """Cuts a stream of bytes into frames. `dropped` counts discarded bytes or lines."""

    dropped: int

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that these bytes complete. Never raises."""

    def reset(self) -> None:
        """Discards a partial frame: the port was closed."""


class Lines:
    """Frames that end with a delimiter, which is removed; frames longer than `longest` are dropped."""

    def __init__(self, end: bytes = b"\n", *, longest: int = 1024) -> None:
        if not end or longest < 1:
            raise ValueError(
                "Lines requires a delimiter of at least one byte and a line length of at least one byte"
            )
        self._end, self._longest = end, longest
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Discards a partial line."""
        self._partial, self._too_long = b"", False

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that these bytes complete."""
        *complete_lines, self._partial = (self._partial + data).split(self._end)
        frames = []
        for line in complete_lines:
            if self._too_long or len(line) > self._longest:
                self.dropped += 1
            else:
                frames.append(line)
            self._too_long = False
        # The last bytes may be part of a delimiter.
        tail_length = len(self._end) - 1
        if len(self._partial) > self._longest + tail_length:
            self._too_long = True
        if self._too_long:
            self._partial = self._partial[len(self._partial) - tail_length :]
        return frames


class Packets:
    """Frames that start with `start` and encode their length in the first `header` bytes.

    `length(head)` is the length of the whole frame in bytes, `sound(frame)` whether its checksum is right;
    both get `bytes` and must not raise. After a damaged frame the framer resynchronises byte by byte.
    """

    def __init__(
        self,
        start: bytes,
        header: int,
        length: Callable[[bytes], int],
        sound: Callable[[bytes], bool] = lambda frame: True,
        *,
        longest: int = 1024,
    ) -> None:
        if not start or header < len(start):
            raise ValueError("Packets requires a start of at least one byte and a header that includes it")
        self._start, self._header, self._length, self._is_valid = start, header, length, sound
        self._longest = longest
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Discards a partial frame."""
        self._partial = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that these bytes complete."""
        self._partial += data
        frames = []
        while (size := self._next()) is not None:
            if size:
                frames.append(bytes(self._partial[:size]))
                del self._partial[:size]
            else:
                self.dropped += 1
                del self._partial[:1]
        return frames

    def _next(self) -> int | None:
        """The length in bytes of the first frame, 0 without one, None if more bytes are needed."""
        self._skip_to_start()
        if len(self._partial) < self._header or not self._partial.startswith(self._start):
            return None
        size = self._length(bytes(self._partial[: self._header]))
        if not self._header <= size <= self._longest:
            return 0
        if len(self._partial) < size:
            return None
        return size if self._is_valid(bytes(self._partial[:size])) else 0

    def _skip_to_start(self) -> None:
        at = self._partial.find(self._start)
        if at < 0:
            # The last bytes may be part of a start.
            tails = range(min(len(self._start) - 1, len(self._partial)), 0, -1)
            tail_length = next((n for n in tails if self._start.startswith(self._partial[-n:])), 0)
            at = len(self._partial) - tail_length
        del self._partial[:at]
