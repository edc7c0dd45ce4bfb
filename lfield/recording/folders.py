"""Folders of recordings: one for each incarnation of a host.

DIR/HOST-20261129T173015-1f3a9c02/   host, UTC time of the start, last digits of the incarnation
    core-000001.lfrec                the host's core: inputs, digests, checkpoints
    guard-DEVICE/                    all that a guard may write; DEVICE is the first one of its bus
        guard-000001.lfrec           inputs and decisions
        wire-000001.tlog             the bytes of a vehicle's link, as its usual tools read them
"""

from __future__ import annotations

import re
import shutil
import time
from calendar import timegm
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote

from lfield.text.secure_files import new_private_folder, private_folder

#: The default limit of all files of one incarnation, in bytes.
DEFAULT_LIMIT = 64 << 20
#: The shares of the core and of each guard with its wire logs together in that limit.
CORE_SHARE = 0.5
#: The number of newest incarnations of a host that a directory keeps in any case. Older ones are kept as long
#: as all have at most this multiple of the limit of one: a host that restarts repeatedly replaces no flight.
INCARNATIONS = 8
#: The maximum number of incarnations of a host in a directory.
MAX_INCARNATIONS = 1000
#: Suffix of the segments of cores and guards.
SUFFIX = ".lfrec"
_GUARD, _TIME = "guard-", "%Y%m%dT%H%M%S"
_NAME = re.compile(r"(?P<host>.+)-(?P<at>\d{8}T\d{6})-(?P<incarnation>[0-9a-f]{8})")


class RecordingFolder(NamedTuple):
    """A folder of one incarnation: its path, host, and the time and incarnation in its name."""

    path: Path
    host: str
    started: str
    incarnation: str


def create_folder(
    parent: Path, host: str, incarnation: int, wall_time: float, limit: int = DEFAULT_LIMIT
) -> Path:
    """A new private folder for an incarnation, whose files have at most `limit` bytes.

    The oldest folders of this host are deleted. Raises OutputFileError.
    """
    private_folder(parent)
    old = [found for found in folders_in(parent) if found.host == host]
    size = limit
    for number, found in enumerate(reversed(old), 2):
        size += _size(found.path)
        if (number > INCARNATIONS and size > INCARNATIONS * limit) or number > MAX_INCARNATIONS:
            shutil.rmtree(found.path, ignore_errors=True)
    # The clock of a computer may be behind after its start: the names keep the order of the starts.
    at = max([wall_time, 0.0, *(_seconds(found.started) + 1.0 for found in old)])
    path = parent / f"{host}-{time_name(at)}-{incarnation & 0xFFFFFFFF:08x}"
    new_private_folder(path)
    return path


def time_name(wall_time: float) -> str:
    """A time in seconds since 1970 as in the names of folders."""
    return time.strftime(_TIME, time.gmtime(wall_time))


def _seconds(started: str) -> float:
    try:
        return float(timegm(time.strptime(started, _TIME)))
    except ValueError:  # digits that are no time: not a folder of lfield
        return 0.0


def _size(folder: Path) -> int:
    """The bytes of the files in a folder. Another process may delete some of them at the same time."""
    size = 0
    for path in folder.rglob("*"):
        with suppress(OSError):
            size += path.lstat().st_size
    return size


def folders_in(parent: Path) -> list[RecordingFolder]:
    """The folders of incarnations in a directory, oldest first."""
    found = [parsed for path in _folders(parent) if (parsed := parse_folder(path)) is not None]
    return sorted(found, key=lambda folder: (folder.started, folder.path.stat().st_mtime_ns))


def parse_folder(path: Path) -> RecordingFolder | None:
    """The data in the name of a folder of an incarnation; None for a folder with another name."""
    matched = _NAME.fullmatch(path.name)
    return None if matched is None else RecordingFolder(path, *matched.group("host", "at", "incarnation"))


def guard_folder(folder: Path, device: str) -> Path:
    """The folder of the guard of a bus, whose first device is `device`, in the folder of an incarnation."""
    return folder / f"{_GUARD}{quote(device, safe='')}"


def guard_folders(folder: Path) -> dict[str, Path]:
    """The folders of the guards of an incarnation, by their first devices."""
    found = sorted(path for path in _folders(folder) if path.name.startswith(_GUARD))
    return {unquote(path.name.removeprefix(_GUARD)): path for path in found}


def segments_of(folder: Path, stem: str, suffix: str = SUFFIX) -> list[Path]:
    """The files of one ring, oldest first."""
    name = re.compile(rf"{re.escape(stem)}-\d{{6,}}{re.escape(suffix)}")
    return sorted(path for path in folder.iterdir() if name.fullmatch(path.name) and path.is_file())


def _folders(parent: Path) -> Iterable[Path]:
    return (path for path in parent.iterdir() if path.is_dir()) if parent.is_dir() else ()
