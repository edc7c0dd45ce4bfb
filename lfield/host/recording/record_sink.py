"""Where the frames of a recording go: a ring of files, or memory in a simulation."""

from __future__ import annotations

from typing import Protocol


class RecordSink(Protocol):
    """Receives the frames of one incarnation, in order."""

    @property
    def is_full(self) -> bool:
        """Whether the next checkpoint should begin a new file."""

    def start_file(self, first: bytes = b"") -> None:
        """Begin the next file with that frame."""

    def append(self, data: bytes) -> None:
        """Append a frame."""

    def close(self) -> None:
        """Write what is pending."""


class MemorySink:
    """Keeps the frames."""

    is_full = False

    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def start_file(self, first: bytes = b"") -> None:
        """Append the first frame."""
        self.frames.append(first)

    def append(self, data: bytes) -> None:
        """Append a frame."""
        self.frames.append(data)

    def close(self) -> None:
        """Nothing is pending."""
