"""What devices had before `lfield setup` wrote to them: on the disk before the first write.

One file of this user, read by people too. An entry has the whole binding, so that the device is found again
without the mission; the newest is last, and is put back first.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from lfield.driver.binding import DeviceBinding
from lfield.errors import DamagedFileError, InputFileError, OutputFileError
from lfield.text.files import reason
from lfield.text.own_folders import state_folder
from lfield.text.private import private_locked, read_private, write_private

#: A larger file is none of ours, in bytes.
_MOST = 16 << 20


class Change(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One setting: what it was, and what was written."""

    name: str
    was: float
    now: float


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What was written to one device at once: when (ISO 8601), to whom, and how it is reached.

    `serial` is what the device has of its own, '' for one that tells nothing: others may be in its place.
    """

    when: str
    identity: str
    changes: list[Change]
    binding: DeviceBinding
    serial: str = ""

    @property
    def who(self) -> str:
        """`ArduPilot copter, system 1, uid 3f21`."""
        return in_words(self.identity, self.serial)


class _Pages(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file, in JSON; another `version` is not read."""

    version: int
    entries: list[Entry]


def in_words(identity: str, serial: str) -> str:
    """Who a device is, for people."""
    return f"{identity}, {serial}" if serial else identity


class Kept:
    """The entries in a file, the oldest first. Several processes may change them at a time."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def entries(self) -> list[Entry]:
        """All of them; none without a file. Raises InputFileError: what cannot be read is not overwritten."""
        try:
            pages = msgspec.json.decode(read_private(self.path, _MOST), type=_Pages)
        except FileNotFoundError:
            return []
        except OSError as error:
            raise InputFileError(str(self.path), reason(error)) from None
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            told = f"it is damaged ({error}); what devices had before is in it: move it away to go on"
            raise DamagedFileError(str(self.path), told) from None
        if pages.version != 1:
            raise DamagedFileError(str(self.path), f"it is of version {pages.version}; this lfield knows 1")
        return pages.entries

    def add(self, entries: Sequence[Entry]) -> None:
        """Have these too, as the newest, on the disk when this returns.

        Raises InputFileError and OutputFileError; then nothing has changed.
        """
        with private_locked(self.path.parent):
            self._write([*self.entries(), *entries])

    def remove(self, entry: Entry) -> None:
        """Have this one no more; nothing changes if somebody else has removed it. Raises as `add`."""
        with private_locked(self.path.parent):
            entries = self.entries()
            if entry in entries:
                entries.remove(entry)
                self._write(entries)

    def _write(self, entries: Sequence[Entry]) -> None:
        """No file for no entries."""
        if entries:
            data = msgspec.json.format(msgspec.json.encode(_Pages(1, list(entries))), indent=1)
            write_private(self.path, data, durable=True)
            return
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise OutputFileError(str(self.path), error.strerror or str(error)) from None


def kept_file(folder: Path | None) -> Path:
    """Where it is: in the folder that is named, else in the service's or the user's own. Raises NoHome."""
    return (folder or state_folder()) / "setup.json"
