"""All parameters of a vehicle as stored settings: compared with a file, for `lfield setup --apply`."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterable, Iterator, Mapping

from lfield.driver import SettingChange, SettingsComparison, is_same_value
from lfield_mavlink.contact.contact import Contact
from lfield_mavlink.files.parameter_facts import effective_after_restart, own_values
from lfield_mavlink.files.parameter_file import ParameterFile, read_parameters
from lfield_mavlink.files.plan_file import FIRMWARES
from lfield_mavlink.modes import STACKS
from lfield_mavlink.parts.returns import RETURN_HEIGHTS
from lfield_mavlink.services.parameters import Parameters
from lfield_mavlink.watchdog import Watchdog

#: Names of the system id by version and autopilot.
SYSTEM_IDS = ("MAV_SYSID", "SYSID_THISMAV", "MAV_SYS_ID")
#: The most parameters that are read one by one, instead of all that the vehicle has.
FEW = 30
#: Share of unknown names above which a file belongs to another firmware or kind of vehicle.
FOREIGN = 0.5


class SettingStore:
    """Reads parameters and compares them with files; writes none."""

    def __init__(self, vehicle: Contact, parameters: Parameters, watchdog: Watchdog) -> None:
        self._vehicle, self._parameters, self._watchdog = vehicle, parameters, watchdog

    async def values(self, names: Iterable[str]) -> dict[str, float]:
        """The present values; unknown names are left out. Raises DeviceError."""
        requested = list(names)
        if len(requested) > FEW:
            stored = await self._parameters.read_all()
            return {name: float(stored[name]) for name in requested if name in stored}
        values = [(name, await self._parameters.read(name)) for name in requested]
        return {name: float(value) for name, value in values if value is not None}

    async def compare(self, file: str, data: bytes) -> SettingsComparison:
        """The differences of a file, and the reasons against writing it. Raises MissionFileError,
        DeviceError.
        """
        content = read_parameters(file, data)
        present = await self._parameters.read_all()
        unknown = [name for name in content.values if name not in present]
        excluded = {*own_values(self._vehicle.profile.autopilot, content.values), *content.read_only}
        changes = [
            SettingChange(name, float(present[name]), value)
            for name, value in content.values.items()
            if name in present and name not in excluded and not is_same_value(float(present[name]), value)
        ]
        foreign = list(self._foreign(content, unknown))
        refusals = foreign or [refusal async for refusal in self._refusals(changes, present)]
        names = [change.name for change in changes]
        return SettingsComparison(
            tuple(changes),
            tuple(unknown),
            tuple(name for name in content.values if name in excluded and name in present),
            tuple(refusals),
            tuple(effective_after_restart(self._vehicle.profile.autopilot, names)),
        )

    def _foreign(self, content: ParameterFile, unknown: list[str]) -> Iterator[str]:
        profile = self._vehicle.profile
        own_type = f"{profile.stack} {profile.kind}"
        if content.firmware and FIRMWARES[content.firmware] != profile.autopilot:
            yield f"the file is of {STACKS[FIRMWARES[content.firmware]]}, and the vehicle is an {own_type}"
        if content.kind and content.kind != profile.kind:
            yield f"the file is of a {content.kind}, and the vehicle is an {own_type}"
        if len(unknown) > FOREIGN * len(content.values):
            count, first = f"{len(unknown)} of its {len(content.values)} names", ", ".join(unknown[:3])
            yield f"{count} are unknown to this {own_type} ({first}): another firmware or kind of vehicle"

    async def _refusals(
        self, changes: list[SettingChange], present: Mapping[str, float]
    ) -> AsyncIterator[str]:
        """Values that the binding forbids, or that the autopilot cannot store."""
        values = {change.name: change.value for change in changes}
        for setting in await self._watchdog.settings_with(values):
            if setting.name in values and not setting.is_right:
                required = f"{setting.present:.9g} and must be {setting.wanted:.9g}"
                yield f"{setting.name} would be {required}: {setting.why}"
        binding, profile = self._vehicle.binding, self._vehicle.profile
        highest = binding.limits.get("altitude")
        units = RETURN_HEIGHTS.get((profile.autopilot, profile.kind), {})
        for name, value in values.items():
            if name in SYSTEM_IDS and value != self._vehicle.system:
                yield f"{name} would be {value:g}, and the binding is of system {self._vehicle.system}"
            if highest is not None and name in units and abs(value) / units[name] > highest:
                yield (
                    f"{name} would let a return climb to {abs(value) / units[name]:g} m, above the limit of "
                    f"{highest:g} m"
                )
            if isinstance(present[name], int) and value != int(value):
                yield f"{name} is an integer, not {value:g}"
