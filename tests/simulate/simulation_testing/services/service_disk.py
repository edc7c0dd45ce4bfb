"""The simulated disk of a service: state, bundles and pieces, as they survive a kill of the service.

A save is atomic and durable, as that of `bundle_store.BundleStore`. The process may be killed just before or
just after a save, the disk may be full, and it may be slow.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cache
from typing import Literal

import msgspec

from lfield.errors import OutputFileError
from lfield.service.bundle_store import ServiceRecord
from lfield.simulate.computers.simulated_computer import SimulatedProcess
from lfield.wire.bundle_pieces import Piece, piece_of, split

_encoder, _decoder = msgspec.msgpack.Encoder(), msgspec.msgpack.Decoder(ServiceRecord)

#: When the process is killed: before or after a save.
KillPoint = Literal["", "before", "after"]
#: Called with the name of a robot and its records before and after a save.
OnSave = Callable[[str, ServiceRecord, ServiceRecord], None]


@cache
def _pieces_of(data: bytes) -> tuple[tuple[Piece, bytes], ...]:
    return tuple((piece_of(part), part) for part in split(data))


class ProcessKilled(BaseException):
    """The process ends here, with all its tasks."""


def kill_here(process: SimulatedProcess) -> None:
    """Kill the process that calls this. Raises ProcessKilled."""
    process.die(-9)
    process.loop.stop()
    raise ProcessKilled


class ServiceDisk:
    """The data that survives the processes of the service of one robot. `on_save` is called within each
    save."""

    def __init__(self, robot: str, on_save: OnSave) -> None:
        self.robot, self._on_save = robot, on_save
        self._state = _encoder.encode(ServiceRecord())
        self.bundles: dict[bytes, bytes] = {}
        self.uploads: dict[bytes, dict[int, bytes]] = {}
        self.is_full = False
        #: Seconds for a save.
        self.slow = 0.0
        self._kill_point: KillPoint = ""
        self._saves_before_kill = 0
        #: Whether the mission's host is killed with the service.
        self.kills_host = False

    def plan_kill(self, point: KillPoint, saves: int = 0) -> None:
        """Kill the service before or after a save, after a number of earlier saves; "" for never."""
        self._kill_point, self._saves_before_kill = point, saves

    def next_point(self) -> KillPoint:
        """Whether the service is killed at the save that begins."""
        if self._kill_point and self._saves_before_kill:
            self._saves_before_kill -= 1
            return ""
        point, self._kill_point = self._kill_point, ""
        return point

    def load(self) -> ServiceRecord:
        """The stored state."""
        return _decoder.decode(self._state)

    def store(self, record: ServiceRecord) -> None:
        """Replace the state."""
        before, self._state = self.load(), _encoder.encode(record)
        self._on_save(self.robot, before, self.load())


class OpenServiceDisk:
    """See `ServiceFiles`: the disk as one process of a service uses it."""

    def __init__(self, disk: ServiceDisk, process: SimulatedProcess) -> None:
        self._disk, self._process = disk, process

    def save(self, record: ServiceRecord) -> None:
        """Replace the state. Raises OutputFileError, ProcessKilled."""
        self._check_usable()
        point = self._disk.next_point()
        if point == "before":
            kill_here(self._process)
        self._disk.store(record)
        if point == "after":
            kill_here(self._process)

    def stored(self) -> list[bytes]:
        """The digests of the stored bundles."""
        return list(self._disk.bundles)

    def read(self, digest: bytes) -> bytes | None:
        """The bytes of a stored bundle."""
        return self._disk.bundles.get(digest)

    def add(self, digest: bytes, data: bytes, kept: list[bytes]) -> None:
        """Store a bundle. Raises OutputFileError."""
        self._check_usable()
        self._disk.bundles[digest] = data

    def start_upload(self, file: bytes, under_way: Collection[bytes]) -> None:
        """Prepare for the pieces of a file. Raises OutputFileError."""
        self._check_usable()
        self._disk.uploads.setdefault(file, {})

    def missing(self, file: bytes, first: int, pieces: list[Piece]) -> list[int]:
        """The offered pieces that are neither stored nor in a stored bundle."""
        known = {piece: part for data in self._disk.bundles.values() for piece, part in _pieces_of(data)}
        stored = self._disk.uploads[file]
        for number, piece in enumerate(pieces, first):
            if number not in stored and piece in known:
                stored[number] = known[piece]
        return [number for number in range(first, first + len(pieces)) if number not in stored]

    def put(self, file: bytes, number: int, data: bytes) -> None:
        """Store a piece. Raises OutputFileError."""
        self._check_usable()
        self._disk.uploads.setdefault(file, {})[number] = data

    def joined(self, file: bytes) -> bytes:
        """The bytes of all stored pieces of a file."""
        return b"".join(data for _, data in sorted(self._disk.uploads.get(file, {}).items()))

    def drop(self, file: bytes) -> None:
        """Remove the pieces of a file."""
        self._disk.uploads.pop(file, None)

    def _check_usable(self) -> None:
        """The later actions of a killed process at this time have no effect on the disk."""
        if self._process.loop.dead:
            raise ProcessKilled
        if self._disk.is_full:
            raise OutputFileError("state.json", "No space left on device")
        if self._disk.slow:
            self._process.loop.hold(self._disk.slow)
