"""Settings that a device stores permanently and that a binding requires.

A mission never writes them. `lfield setup` writes them after confirmation and backs up the old values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import msgspec


class Setting(msgspec.Struct, frozen=True):
    """One stored setting that a binding requires: its name, the required value and the reason.

    Values are in the device's own units, as in its manual.
    """

    name: str
    present: float
    wanted: float
    why: str

    @property
    def is_right(self) -> bool:
        """Whether the present value is right, within the precision of a 32-bit float."""
        return is_same_value(self.present, self.wanted)

    def __str__(self) -> str:
        return f"{self.name} is {self.present:.9g} and must be {self.wanted:.9g}"


def is_same_value(first: float, second: float) -> bool:
    """Whether two values are equal to a device that stores 32-bit floats."""
    return math.isclose(first, second, rel_tol=1e-6)


def mismatched(settings: Sequence[Setting]) -> list[Setting]:
    """The settings with a wrong value."""
    return [setting for setting in settings if not setting.is_right]


@dataclass(frozen=True, slots=True)
class SettingChange:
    """One stored setting with its present value, and another `value` for it."""

    name: str
    present: float
    value: float


@dataclass(frozen=True, slots=True)
class SettingsComparison:
    """A file with settings compared with a device.

    `changes` are in the order of the file. `unknown` are names that the device does not have, `kept` names
    that the device sets itself; neither is written. `refusals` are sentences with the reasons why the file
    must not be written. `restart` are the names of changes that take effect after a restart, as far as known.
    """

    changes: Sequence[SettingChange] = ()
    unknown: Sequence[str] = ()
    kept: Sequence[str] = ()
    refusals: Sequence[str] = ()
    restart: Sequence[str] = ()


@runtime_checkable
class StoredSettings(Protocol):
    """A device with stored settings that files of other programs contain (optional, in addition to
    `Device`).
    """

    async def stored_settings(self, names: Iterable[str]) -> Mapping[str, float]:
        """The present values; unknown names are omitted. Raises DeviceError."""

    async def compare_settings(self, file: str, data: bytes) -> SettingsComparison:
        """The differences of a file. Raises MissionFileError if it is not readable, DeviceError."""
