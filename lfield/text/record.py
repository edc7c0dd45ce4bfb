"""What a host keeps on disk of its starts: one number, so that a later start never counts as an earlier one.

One small file for each deployment, by its name, and host: it stays when the mission changes. It is written
whole, and is on the disk before the coordinators of that start begin.
"""

from __future__ import annotations

import asyncio
import os
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Protocol
from urllib.parse import quote

import msgspec
from msgspec import Meta

from lfield.text.private import read_private, write_private

#: A larger file is none of ours.
_MOST = 4096


class Record(Protocol):
    """Where a host keeps the number of its last start."""

    def read(self) -> int | None:
        """The last start; None when there is no record of any."""

    async def write(self, generation: int) -> None:
        """Keep the number of a start, for good. Raises OutputFileError."""


class _Page(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the file says, in JSON; `check` is the CRC-32 of the rest, since a digit may be wrong too."""

    starts: Annotated[int, Meta(ge=0, lt=2**62)]
    check: int


class FileRecord:
    """The record in a file of this user alone. `tell` hears what is wrong with it."""

    def __init__(self, path: Path, tell: Callable[[str], None]) -> None:
        self.path, self._tell = path, tell

    def read(self) -> int | None:
        """The last start. A damaged file is moved aside and counts as none, and so does one of others."""
        try:
            page = msgspec.json.decode(read_private(self.path, _MOST), type=_Page)
        except FileNotFoundError:
            return None
        except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            self._aside(str(error))
            return None
        if page.check == _check(page.starts):
            return page.starts
        self._aside("its checksum does not fit")
        return None

    async def write(self, generation: int) -> None:
        """In a thread: no beat of a guard waits for a disk."""
        data = msgspec.json.encode(_Page(generation, _check(generation)))
        await asyncio.to_thread(write_private, self.path, data, durable=True)

    def _aside(self, why: str) -> None:
        aside = self.path.with_name(self.path.name + ".damaged")
        moved = "it stays where it is"
        with suppress(OSError):
            self.path.replace(aside)
            moved = f"it is now {aside.name}"
        self._tell(f"the record of earlier starts in {self.path} cannot be believed ({why}): {moved}")


def _check(starts: int) -> int:
    return zlib.crc32(b"%d" % starts)


def record_file(folder: Path | None, deployment: str, host: str) -> Path:
    """Where the record of a host is: in the folder that is named, else in the service's or the user's own."""
    place = f"{quote(deployment, safe='')}@{quote(host, safe='')}"
    return (folder or state_folder()) / place / "starts.json"


def state_folder() -> Path:
    """The folder of what outlives a run: the service's, else the user's own."""
    # systemd names all state folders of a unit, with colons between.
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if service:
        return Path(service)
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base else Path.home() / ".local" / "state") / "lfield"
