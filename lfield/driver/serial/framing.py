"""Bytes of a serial port cut into frames: pure, the same however the bytes are split, bounded memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Framer(Protocol):
    """Cuts a stream of bytes into frames. `dropped` counts what was no frame."""

    dropped: int

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that these bytes complete. Never raises."""

    def reset(self) -> None:
        """Forget what has begun: the port was away."""


class Lines:
    """Frames that end with a delimiter, which is not handed out; those longer than `longest` are dropped."""

    def __init__(self, end: bytes = b"\n", *, longest: int = 1024) -> None:
        if not end or longest < 1:
            raise ValueError("a delimiter of at least a byte and lines of at least one are wanted")
        self._end, self._longest = end, longest
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Forget what has begun."""
        self._begun, self._too_long = b"", False

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that these bytes complete."""
        *whole, self._begun = (self._begun + data).split(self._end)
        frames = []
        for line in whole:
            if self._too_long or len(line) > self._longest:
                self.dropped += 1
            else:
                frames.append(line)
            self._too_long = False
        # The last bytes may be the beginning of a delimiter.
        kept = len(self._end) - 1
        if len(self._begun) > self._longest + kept:
            self._too_long = True
        if self._too_long:
            self._begun = self._begun[len(self._begun) - kept :]
        return frames


class Packets:
    """Frames that begin with `start` and tell their length in their first `header` bytes.

    `length(head)` is that of the whole frame in bytes, `sound(frame)` whether its checksum is right; both get
    `bytes` and must not raise. What is no frame is skipped byte by byte, so that a damaged one costs no more
    than itself.
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
            raise ValueError("a start of at least a byte, and a header that has it, are wanted")
        self._start, self._header, self._length, self._sound = start, header, length, sound
        self._longest = longest
        self.dropped = 0
        self.reset()

    def reset(self) -> None:
        """Forget what has begun."""
        self._begun = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The frames that these bytes complete."""
        self._begun += data
        frames = []
        while (size := self._next()) is not None:
            if size:
                frames.append(bytes(self._begun[:size]))
                del self._begun[:size]
            else:
                self.dropped += 1
                del self._begun[:1]
        return frames

    def _next(self) -> int | None:
        """Bytes of the frame at the beginning, 0 when there is none, None when more must come first."""
        self._skip_to_start()
        if len(self._begun) < self._header or not self._begun.startswith(self._start):
            return None
        size = self._length(bytes(self._begun[: self._header]))
        if not self._header <= size <= self._longest:
            return 0
        if len(self._begun) < size:
            return None
        return size if self._sound(bytes(self._begun[:size])) else 0

    def _skip_to_start(self) -> None:
        at = self._begun.find(self._start)
        if at < 0:
            # The last bytes may be the beginning of a start.
            tails = range(min(len(self._start) - 1, len(self._begun)), 0, -1)
            kept = next((n for n in tails if self._start.startswith(self._begun[-n:])), 0)
            at = len(self._begun) - kept
        del self._begun[:at]
