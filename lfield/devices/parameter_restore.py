"""Restores the settings that devices had before `lfield setup`.

A backup belongs to a device, not to its endpoint, at which another device may be now: the backup is refused
for a device with another unique identifier. A setting that has been changed since then is not restored.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from msgspec import Struct

from lfield.devices.device_setup import FoundDevice, Report, failure_sentence
from lfield.devices.parameter_backup import BackupEntry, ParameterChange
from lfield.driver.settings import is_same_value


class RestorePlan(Struct, frozen=True):
    """The values to be written to one device, and a sentence for each setting that is not restored."""

    entry: BackupEntry
    found: FoundDevice
    writes: Sequence[ParameterChange]
    problems: Sequence[str]

    def lines(self) -> list[str]:
        """The plan, for the user."""
        entry = self.entry
        lines = [f"{change.name} from {change.now:.9g} back to {change.was:.9g}" for change in self.writes]
        if not lines:
            lines.append("nothing to write")
        elif not entry.serial:
            lines.append(f"{self.found.label}: whether it is the same device cannot be verified")
        heading = f"{entry.binding.name}, {entry.label} at {entry.binding.endpoint}, since {entry.when}:"
        return [heading, *(f"    {line}" for line in (*lines, *self.problems))]


def plan_restore(
    entry: BackupEntry, device: FoundDevice, present: Mapping[str, float] | None = None
) -> RestorePlan:
    """Compares the device at the endpoint of an entry with the entry, without writing. `present` are the
    values of its settings, by default of the settings that its binding needs.
    """
    if entry.serial and device.serial != entry.serial:
        problem = f"{device.name}: {device.label} is now at {entry.binding.endpoint}, not {entry.label}"
        return RestorePlan(entry, device, [], [f"{problem}: nothing is written"])
    if present is None:
        present = {setting.name: setting.present for setting in device.settings}
    writes, problems = list[ParameterChange](), list[str]()
    for change in entry.changes:
        value = present.get(change.name)
        if value is not None and is_same_value(value, change.was):
            continue
        if value is not None and is_same_value(value, change.now):
            writes.append(change)
            continue
        state = "is not reported" if value is None else f"is {value:.9g}, which setup has not written"
        problems.append(f"{device.name}: {change.name} {state}: left alone; it was {change.was:.9g} before")
    return RestorePlan(entry, device, writes, problems)


async def apply_restore(plan: RestorePlan, report: Report) -> list[str]:
    """Executes a plan; returns a sentence for each setting that was not restored or could not be written."""
    name, device = plan.found.name, plan.found.device
    try:
        if plan.writes:
            device.check_idle()
        for change in plan.writes:
            await device.write_setting(change.name, change.was)
            report(f"{name}: {change.name} was {change.now:.9g} and is {change.was:.9g} again")
    except Exception as error:  # a driver is third-party code: report any exception
        return [*plan.problems, failure_sentence(name, error)]
    return list(plan.problems)
