"""Folders of recordings: one for each incarnation of a host.

DIR/HOST-20261129T173015-1f3a9c02/   host, UTC time of the start, first digits of the incarnation
    core-000001.lfrec                the host's core: inputs, digests, checkpoints
    guard-DEVICE/                    all that a guard may write; DEVICE is the first one of its bus
        guard-000001.lfrec           inputs and decisions
        wire-000001.tlog             the bytes of a vehicle's link, as its usual tools read them
"""

from __future__ import annotations

import re
import shutil
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote

from lfield.text.secure_files import new_private_folder, private_folder

#: The limit of all files of one incarnation unless set, in bytes.
DEFAULT_LIMIT = 64 << 20
#: The shares of the core and of each guard with its wire logs together in that limit.
CORE_SHARE = 0.5
#: How many incarnations of a host a folder keeps, the newest ones.
INCARNATIONS = 8
#: Suffix of the segments of cores and guards.
SUFFIX = ".lfrec"
_GUARD = "guard-"
_NAME = re.compile(r"(?P<host>.+)-(?P<at>\d{8}T\d{6})-(?P<incarnation>[0-9a-f]{8})")


class RecordingFolder(NamedTuple):
    """A folder of one incarnation: its path, host, and the time and incarnation in its name."""

    path: Path
    host: str
    started: str
    incarnation: str


def create_folder(parent: Path, host: str, incarnation: int, wall_time: float) -> Path:
    """A new private folder for an incarnation; the oldest ones of this host are deleted.

    Raises OutputFileError.
    """
    private_folder(parent)
    old = [found for found in folders_in(parent) if found.host == host]
    for found in old[: max(0, len(old) - INCARNATIONS + 1)]:
        shutil.rmtree(found.path, ignore_errors=True)
    at = time.strftime("%Y%m%dT%H%M%S", time.gmtime(max(0.0, wall_time)))
    path = parent / f"{host}-{at}-{incarnation & 0xFFFFFFFF:08x}"
    new_private_folder(path)
    return path


def folders_in(parent: Path) -> list[RecordingFolder]:
    """The folders of incarnations in a directory, oldest first."""
    found = [parsed for path in _folders(parent) if (parsed := parse_folder(path)) is not None]
    return sorted(found, key=lambda folder: (folder.started, folder.path.stat().st_mtime_ns))


def parse_folder(path: Path) -> RecordingFolder | None:
    """The folder as one of an incarnation; None if its name is not that of one."""
    matched = _NAME.fullmatch(path.name)
    return None if matched is None else RecordingFolder(path, *matched.group("host", "at", "incarnation"))


def guard_folder(folder: Path, device: str) -> Path:
    """The folder of the guard of a bus, whose first device is this one, in that of an incarnation."""
    return folder / f"{_GUARD}{quote(device, safe='')}"


def guard_folders(folder: Path) -> dict[str, Path]:
    """The folders of the guards of an incarnation, by their first devices."""
    found = sorted(path for path in _folders(folder) if path.name.startswith(_GUARD))
    return {unquote(path.name.removeprefix(_GUARD)): path for path in found}


def segments_of(folder: Path, stem: str, suffix: str = SUFFIX) -> list[Path]:
    """The files of one ring, oldest first."""
    name = re.compile(rf"{re.escape(stem)}-\d{{6,}}{re.escape(suffix)}")
    return sorted(path for path in folder.iterdir() if name.fullmatch(path.name))


def _folders(parent: Path) -> Iterable[Path]:
    return (path for path in parent.iterdir() if path.is_dir()) if parent.is_dir() else ()
