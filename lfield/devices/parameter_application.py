"""Writes a parameter file of a ground station into one device (`lfield setup --apply`).

The driver compares the file with the device; a value that the binding forbids leads to the refusal of the
whole file. The old values are in a backup before the first write, and every written value is read back at the
end.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from msgspec import Struct

from lfield.devices.device_setup import FoundDevice, Report, failure_sentence
from lfield.devices.parameter_backup import BackupEntry, ParameterChange, write_backup
from lfield.driver.settings import SettingsComparison, StoredSettings, is_same_value
from lfield.errors import DevicesError, MissionFileError, UsageError

#: The maximum number of names in one line.
_LISTED = 12


class FilePlan(Struct, frozen=True):
    """The changes of a device by a file, before any write."""

    file: str
    found: FoundDevice
    comparison: SettingsComparison

    def lines(self) -> Iterator[str]:
        """The differences, and the settings that are not changed, for the user."""
        comparison = self.comparison
        yield f"{self.found.name}, {self.found.label}, and {self.file}:"
        for change in comparison.changes:
            yield f"    {change.name} from {change.present:.9g} to {change.value:.9g}"
        if not comparison.changes:
            yield "    nothing to write"
        if comparison.unknown:
            yield f"    unknown to the device, not written: {_listed(comparison.unknown)}"
        if comparison.kept:
            yield f"    set by the device itself, not written: {_listed(comparison.kept)}"
        if comparison.restart:
            yield f"    effective after a restart: {_listed(comparison.restart)}"


async def plan_file(found: FoundDevice, file: str, data: bytes) -> FilePlan:
    """Compares a file with a device. Raises UsageError, MissionFileError, DevicesError."""
    device = found.device
    if not isinstance(device, StoredSettings):
        raise UsageError(f"{found.name} has no settings that files contain")
    try:
        return FilePlan(file, found, await device.compare_settings(file, data))
    except Exception as error:  # a driver is third-party code: report any exception
        raise DevicesError([failure_sentence(found.name, error)]) from None


def check_permitted(plan: FilePlan, report: Report) -> None:
    """Reports the reasons why a file must not be written. Raises MissionFileError."""
    for reason in plan.comparison.refusals:
        report(f"{plan.found.name}: {reason}")
    if count := len(plan.comparison.refusals):
        reason = "a reason is" if count == 1 else f"{count} reasons are"
        raise MissionFileError(plan.file, f"nothing was written: {reason} above")


async def write_file(plan: FilePlan, folder: Path, when: str, report: Report) -> None:
    """Writes the changes of a plan after a backup. Raises DevicesError, OutputFileError."""
    found, changes = plan.found, plan.comparison.changes
    try:
        found.device.check_idle()
        entry = BackupEntry(
            when,
            found.identity,
            [ParameterChange(change.name, change.present, change.value) for change in changes],
            found.device.binding,
            found.serial,
        )
        backup = write_backup(folder, [entry])
        report(f"the present values are saved in {backup}; 'lfield setup --apply {backup}' restores them")
        for change in changes:
            await found.device.write_setting(change.name, change.value)
            report(f"{found.name}: {change.name} was {change.present:.9g} and is now {change.value:.9g}")
        # A write may change another parameter.
        present = await _read_back(found, [change.name for change in changes])
    except Exception as error:  # a driver is third-party code: report any exception
        raise DevicesError([failure_sentence(found.name, error)]) from None
    problems = [
        f"{found.name}: {change.name} is not {change.value:.9g} any more: another value has changed it"
        for change in changes
        if change.name not in present or not is_same_value(present[change.name], change.value)
    ]
    if problems:
        raise DevicesError(problems)


async def stored_values(found: FoundDevice, names: Sequence[str]) -> Mapping[str, float]:
    """The present values of settings of a device, including settings that its binding does not need.

    Raises DevicesError.
    """
    present = {setting.name: setting.present for setting in found.settings}
    missing = [name for name in names if name not in present]
    if missing and isinstance(found.device, StoredSettings):
        try:
            present.update(await found.device.stored_settings(names))
        except Exception as error:  # a driver is third-party code: report any exception
            raise DevicesError([failure_sentence(found.name, error)]) from None
    return present


async def _read_back(found: FoundDevice, names: Sequence[str]) -> Mapping[str, float]:
    assert isinstance(found.device, StoredSettings), "plan_file has checked it"
    return await found.device.stored_settings(names)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f", and {more} more" if more > 0 else "")
