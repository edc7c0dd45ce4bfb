"""Parser of the write-ahead log (WAL) of a journal, to detect damage that SQLite interprets as the end of the
log.

A frame is an image of a page of the database; its checksum continues the checksum of the previous frame
(sqlite.org/walformat.html). SQLite uses the frames before the first frame with a wrong checksum. This is
correct after a power cut: no frame follows a commit that is not durable. But when a bit of an older frame is
damaged, or the whole log is missing, the later commits would be lost silently, and the host would answer from
an older state.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_HEAD, _FRAME = struct.Struct(">IIII8sII"), struct.Struct(">II8sII")
#: The magic number of a log; plus one if its checksums use big-endian words.
_MAGIC = 0x377F0682
_PAGE_SIZES = frozenset(1 << power for power in range(9, 17))

#: A checksum, which is the start value of the next one.
Checksums = tuple[int, int]


class WalFrame(NamedTuple):
    """The image of page `number`. `size` is the size of the database in pages at the end of a commit, else 0.

    Without `is_checksum_valid`, number and size are as stated in the damaged frame.
    """

    number: int
    size: int
    image: bytes
    is_checksum_valid: bool


class Wal(NamedTuple):
    """All frames since the last restart of the log, and the length of the prefix that SQLite accepts."""

    frames: list[WalFrame]
    valid_prefix: int

    @property
    def fault(self) -> str:
        """The fault of the log, '' for none. A power cut leaves at most a part of one commit."""
        behind = self.frames[self.valid_prefix :]
        last = max((at for at, frame in enumerate(behind) if frame.is_checksum_valid), default=0)
        if not any(frame.size for frame in behind[:last]):
            return ""
        return f"frame {self.valid_prefix + 1} of the {len(self.frames)} of its log is damaged"


def wal_file(database: Path) -> Path:
    """The path of SQLite's log of a database."""
    return database.with_name(f"{database.name}-wal")


def set_dirty_flag(database: Path) -> None:
    """Record that a log exists until the journal is closed in order: with this record, a missing log is a
    lost log.
    """
    with suppress(OSError):
        _flag_file(database).touch(0o600)
        sync_folder(database.parent)


def clear_dirty_flag(database: Path) -> None:
    """Record that there may be no log from now on."""
    with suppress(OSError):
        _flag_file(database).unlink()
        sync_folder(database.parent)


def is_wal_missing(database: Path) -> bool:
    """Whether there was a log without a checkpoint. Raises OSError."""
    if not _flag_file(database).exists():
        return False
    try:
        return wal_file(database).stat().st_size <= _HEAD.size
    except FileNotFoundError:
        return True


def sync_folder(folder: Path) -> None:
    """Make created and deleted names in a folder durable. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flag_file(database: Path) -> Path:
    return database.with_name("host.logged")


def read_wal(database: Path) -> Wal:
    """The log of a database, empty if there is none. Raises OSError."""
    try:
        data = wal_file(database).read_bytes()
    except FileNotFoundError:
        return Wal([], 0)
    if len(data) < _HEAD.size + _FRAME.size:
        return Wal([], 0)
    return _parse(data)


def rebuild_database(database: bytes, log: Wal) -> tuple[bytes, bool]:
    """The database with all valid frames applied, and whether it is complete (every invalid frame is
    replaced).
    """
    last = max(
        (at for at, frame in enumerate(log.frames) if frame.is_checksum_valid and frame.size), default=-1
    )
    if last < 0:
        return database, False
    size = len(log.frames[last].image)
    image, missing = bytearray(database), set[int]()
    for frame in log.frames[: last + 1]:
        if not frame.is_checksum_valid:
            missing.add(frame.number)
            continue
        missing.discard(frame.number)
        image[(frame.number - 1) * size : frame.number * size] = frame.image
    return bytes(image[: log.frames[last].size * size]), not missing


def _parse(data: bytes) -> Wal:
    magic, _, page_size, _, salts, *sums = _HEAD.unpack_from(data)
    order = ">" if magic & 1 else "<"
    is_valid = magic & ~1 == _MAGIC and tuple(sums) == _checksums(data[: _HEAD.size - 8], (0, 0), order)
    if page_size not in _PAGE_SIZES:
        page_size = 4096
    slots = list(_frame_slots(data, page_size))
    if not is_valid and slots:
        salts = slots[0][2]
    end = max((at + 1 for at, slot in enumerate(slots) if slot[2] == salts), default=0)
    before: Checksums = sums[0], sums[1]
    frames, believed, is_contiguous = list[WalFrame](), 0, is_valid
    for number, size, stored_salts, checked, image, found in slots[:end]:
        fits = (
            stored_salts == salts
            and number > 0
            and found == _checksums(image, _checksums(checked, before, order), order)
        )
        frames.append(
            WalFrame(number, size, image, fits)
            if stored_salts == salts
            else WalFrame(0, 0, image, is_checksum_valid=False)
        )
        is_contiguous = is_contiguous and fits
        believed += is_contiguous
        before = found
    return Wal(frames, believed)


def _frame_slots(data: bytes, page_size: int) -> Iterator[tuple[int, int, bytes, bytes, bytes, Checksums]]:
    """The frames: number, size, salts, checksummed part of the header, image, checksums."""
    step = _FRAME.size + page_size
    for at in range(_HEAD.size, len(data) - step + 1, step):
        number, size, salts, *sums = _FRAME.unpack_from(data, at)
        image = data[at + _FRAME.size : at + step]
        yield number, size, salts, data[at : at + 8], image, (sums[0], sums[1])


def _checksums(data: bytes, start: Checksums, order: str) -> Checksums:
    first, second = start
    for even, odd in struct.iter_unpack(f"{order}II", data):
        first = (first + even + second) & 0xFFFFFFFF
        second = (second + odd + first) & 0xFFFFFFFF
    return first, second
