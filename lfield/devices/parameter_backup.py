"""Backup of settings that `lfield setup` overwrites: a JSON file per run, on disk before the first write.

An entry contains the whole binding, so that the device is found without the mission.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from lfield.driver.binding import DeviceBinding
from lfield.errors import DamagedFileError, InputFileError
from lfield.text.input_files import error_reason
from lfield.text.secure_files import lock_private_folder, read_private, write_private
from lfield.text.user_dirs import state_dir

#: Largest accepted file in bytes.
_MAX_SIZE = 16 << 20
_VERSION = 2


class ParameterChange(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One setting: the old value and the written value."""

    name: str
    was: float
    now: float


class BackupEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The settings of one device: the time of writing (ISO 8601), the device, and its binding.

    `serial` is the device's unique identifier, '' for none: another device may then have replaced it.
    """

    when: str
    identity: str
    changes: list[ParameterChange]
    binding: DeviceBinding
    serial: str = ""

    @property
    def label(self) -> str:
        """`ArduPilot copter, system 1, uid 3f21`."""
        return device_label(self.identity, self.serial)


class _BackupFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The file as JSON; another `version` is refused."""

    version: int
    entries: list[BackupEntry]


def device_label(identity: str, serial: str) -> str:
    """Describes a device."""
    return f"{identity}, {serial}" if serial else identity


def backup_folder(folder: Path | None) -> Path:
    """The folder of the files: the given one, otherwise the folder of the service or user. Raises
    NoHomeFolder.
    """
    return folder or state_dir()


def write_backup(folder: Path, entries: Sequence[BackupEntry]) -> Path:
    """Writes a new file `setup-NUMBER.json`; the file is on disk when the function returns. Raises
    OutputFileError.
    """
    with lock_private_folder(folder):
        path = folder / f"setup-{max(_numbers(folder), default=0) + 1}.json"
        data = msgspec.json.format(msgspec.json.encode(_BackupFile(_VERSION, list(entries))), indent=1)
        write_private(path, data, durable=True)
    return path


def newest_backup(folder: Path) -> Path | None:
    """The newest file of a folder; None without one."""
    return folder / f"setup-{number}.json" if (number := max(_numbers(folder), default=0)) else None


def _numbers(folder: Path) -> list[int]:
    names = (path.stem.removeprefix("setup-") for path in folder.glob("setup-*.json"))
    return [int(name) for name in names if name.isascii() and name.isdecimal()]


def read_backup(path: Path) -> list[BackupEntry]:
    """The entries of a file. Raises InputFileError."""
    try:
        file = msgspec.json.decode(read_private(path, _MAX_SIZE), type=_BackupFile)
    except OSError as error:
        raise InputFileError(str(path), error_reason(error)) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise DamagedFileError(str(path), f"not a backup of 'lfield setup': {error}") from None
    if file.version != _VERSION:
        reason = f"it has version {file.version}; this lfield supports version {_VERSION}"
        raise DamagedFileError(str(path), reason)
    return file.entries
