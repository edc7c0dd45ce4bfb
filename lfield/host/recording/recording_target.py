"""The destination of the recordings of hosts: a directory, or memory in a simulation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from lfield.guard.messages import NO_RECORDING, GuardRecording
from lfield.recording.folders import CORE_SHARE, SUFFIX, create_folder
from lfield.recording.ring_writer import RingWriter
from lfield.recording.segments import MAGIC
from lfield.text.secure_files import write_private

#: The file of the mission's bundle in the folder of an incarnation, and the stem of the core's ring.
BUNDLE_NAME, CORE_STEM = "mission.lfm", "core"


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
        """Write the pending data."""


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
        """No data is pending."""


class RecordingTarget(Protocol):
    """Opens the recordings of incarnations."""

    @property
    def flush_interval(self) -> float | None:
        """Seconds after which records are written although no turn follows; None for no such limit."""

    def open_sink(
        self, host: str, incarnation: int, wall_time: float, bundle: bytes, on_failure: Callable[[str], None]
    ) -> RecordSink:
        """The sink for the core of an incarnation that starts at a time (seconds since 1970).

        `bundle` is the bundle of the mission that runs. `on_failure` may be called in another thread, with
        the reason. Raises OutputFileError.
        """

    def for_guards(self, host: str, incarnation: int, run: str) -> GuardRecording:
        """The recording of the guards of an incarnation."""


class RecordingDirectory:
    """Recordings as folders in `parent`, each with at most `limit` bytes."""

    flush_interval = 0.25

    def __init__(self, parent: Path, limit: int) -> None:
        self._parent, self._limit = parent, limit
        #: The folders by host and incarnation.
        self._opened: dict[tuple[str, int], Path] = {}

    def open_sink(
        self, host: str, incarnation: int, wall_time: float, bundle: bytes, on_failure: Callable[[str], None]
    ) -> RecordSink:
        """See `RecordingTarget`."""
        folder = create_folder(self._parent, host, incarnation, wall_time, self._limit)
        write_private(folder / BUNDLE_NAME, bundle)
        self._opened[host, incarnation] = folder
        limit = int(self._limit * CORE_SHARE)
        return RingWriter(folder, CORE_STEM, SUFFIX, limit, on_failure, MAGIC)

    def for_guards(self, host: str, incarnation: int, run: str) -> GuardRecording:
        """See `RecordingTarget`."""
        folder = self._opened.get((host, incarnation))
        if folder is None:
            return NO_RECORDING
        return GuardRecording(str(folder), int(self._limit * (1.0 - CORE_SHARE)), run)


class RecordingMemory:
    """Recordings in memory, by host and incarnation, in the order of their starts.

    The recordings wake no host, so that a simulation runs as without them.
    """

    flush_interval = None

    def __init__(self) -> None:
        self.sinks: list[tuple[str, int, MemorySink]] = []

    def open_sink(
        self, host: str, incarnation: int, wall_time: float, bundle: bytes, on_failure: Callable[[str], None]
    ) -> RecordSink:
        """See `RecordingTarget`."""
        sink = MemorySink()
        self.sinks.append((host, incarnation, sink))
        return sink

    def for_guards(self, host: str, incarnation: int, run: str) -> GuardRecording:
        """See `RecordingTarget`."""
        return NO_RECORDING
