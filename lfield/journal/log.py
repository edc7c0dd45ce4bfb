"""The write-ahead log of a journal, read by ourselves: where it is damaged, SQLite takes it to end there.

A frame is an image of a page of the database, and the checksum of each goes on from the one before
(sqlite.org/walformat.html). SQLite believes the frames before the first that does not fit. That is right
after a power cut: nothing is written behind a commit before that is on the disk. But where one bit of an
older frame is damaged, or the whole log is missing, the commits behind it would be gone without a word, and
the host would answer from an older memory.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_HEAD, _FRAME = struct.Struct(">IIII8sII"), struct.Struct(">II8sII")
#: The number that a log begins with; one more where its checksums are of big-endian words.
_MAGIC = 0x377F0682
_PAGE_SIZES = frozenset(1 << power for power in range(9, 17))

#: A checksum, which is also what the next one goes on from.
Sums = tuple[int, int]


class Frame(NamedTuple):
    """The image of page `number`. `size` is that of the database in pages where a commit ends, else 0.

    One that does not `fit` its checksum has a number and a size only if it says so.
    """

    number: int
    size: int
    image: bytes
    fits: bool


class Log(NamedTuple):
    """All frames since the log last began anew, and of how many from the first one SQLite believes all."""

    frames: list[Frame]
    believed: int

    @property
    def fault(self) -> str:
        """What is wrong with it, '' for nothing. What a power cut leaves is a part of one commit, no more."""
        behind = self.frames[self.believed :]
        last = max((at for at, frame in enumerate(behind) if frame.fits), default=0)
        if not any(frame.size for frame in behind[:last]):
            return ""
        return f"frame {self.believed + 1} of the {len(self.frames)} of its log is damaged"


def log_file(database: Path) -> Path:
    """Where SQLite has the log of a database."""
    return database.with_name(f"{database.name}-wal")


def mark(database: Path) -> None:
    """From here on there is a log, until it is closed in order: one that is missing then was lost."""
    with suppress(OSError):
        _marked(database).touch(0o600)
        sync_folder(database.parent)


def unmark(database: Path) -> None:
    """There may be no log from here on."""
    with suppress(OSError):
        _marked(database).unlink()
        sync_folder(database.parent)


def is_missing(database: Path) -> bool:
    """Whether there was a log that nobody has worked into the database. Raises OSError."""
    if not _marked(database).exists():
        return False
    try:
        return log_file(database).stat().st_size <= _HEAD.size
    except FileNotFoundError:
        return True


def sync_folder(folder: Path) -> None:
    """What was made and removed in it is on the disk. Raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _marked(database: Path) -> Path:
    return database.with_name("host.logged")


def read_log(database: Path) -> Log:
    """The log of a database, empty if there is none. Raises OSError."""
    try:
        data = log_file(database).read_bytes()
    except FileNotFoundError:
        return Log([], 0)
    if len(data) < _HEAD.size + _FRAME.size:
        return Log([], 0)
    return _read(data)


def rebuilt(database: bytes, log: Log) -> tuple[bytes, bool]:
    """The database with all frames that fit; whether nothing is missing, for all that did not is replaced."""
    last = max((at for at, frame in enumerate(log.frames) if frame.fits and frame.size), default=-1)
    if last < 0:
        return database, False
    size = len(log.frames[last].image)
    image, missing = bytearray(database), set[int]()
    for frame in log.frames[: last + 1]:
        if not frame.fits:
            missing.add(frame.number)
            continue
        missing.discard(frame.number)
        image[(frame.number - 1) * size : frame.number * size] = frame.image
    return bytes(image[: log.frames[last].size * size]), not missing


def _read(data: bytes) -> Log:
    magic, _, page, _, salts, *sums = _HEAD.unpack_from(data)
    order = ">" if magic & 1 else "<"
    sound = magic & ~1 == _MAGIC and tuple(sums) == _sums(data[: _HEAD.size - 8], (0, 0), order)
    if page not in _PAGE_SIZES:
        page = 4096
    slots = list(_slots(data, page))
    if not sound and slots:
        salts = slots[0][2]
    end = max((at + 1 for at, slot in enumerate(slots) if slot[2] == salts), default=0)
    before: Sums = sums[0], sums[1]
    frames, believed, goes_on = list[Frame](), 0, sound
    for number, size, told, checked, image, found in slots[:end]:
        fits = told == salts and number > 0 and found == _sums(image, _sums(checked, before, order), order)
        frames.append(Frame(number, size, image, fits) if told == salts else Frame(0, 0, image, fits=False))
        goes_on = goes_on and fits
        believed += goes_on
        before = found
    return Log(frames, believed)


def _slots(data: bytes, page: int) -> Iterator[tuple[int, int, bytes, bytes, bytes, Sums]]:
    """What stands where frames are: number, size, salts, what of the header is checked, image, sums."""
    step = _FRAME.size + page
    for at in range(_HEAD.size, len(data) - step + 1, step):
        number, size, salts, *sums = _FRAME.unpack_from(data, at)
        image = data[at + _FRAME.size : at + step]
        yield number, size, salts, data[at : at + 8], image, (sums[0], sums[1])


def _sums(data: bytes, start: Sums, order: str) -> Sums:
    first, second = start
    for one, other in struct.iter_unpack(f"{order}II", data):
        first = (first + one + second) & 0xFFFFFFFF
        second = (second + other + first) & 0xFFFFFFFF
    return first, second
