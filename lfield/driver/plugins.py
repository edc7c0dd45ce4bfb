"""Finds the installed driver plugins by their entry points (`lfield.drivers.v1`)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points

from lfield.driver.manifest_file import Manifest
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import PluginError
from lfield.manifest import DeviceManifest

GROUP = "lfield.drivers.v1"


@dataclass(frozen=True, slots=True)
class Installed:
    """One usable plugin; `reference` is how another process imports it."""

    plugin: Plugin
    manifest: Manifest
    reference: str


@dataclass(slots=True)
class Plugins:
    """What is installed, and a sentence for each plugin that cannot be used."""

    by_driver: dict[str, Installed] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def manifests(self) -> dict[str, DeviceManifest]:
        """Device types by their name in L, as the compiler needs them."""
        return {found.manifest.device.type: found.manifest.device for found in self.by_driver.values()}

    def for_type(self, device_type: str) -> Installed | None:
        """The plugin of a device type."""
        return next((i for i in self.by_driver.values() if i.manifest.device.type == device_type), None)

    def add(self, reference: str) -> None:
        """Take a plugin in, or note why it cannot be. Raises PluginError on a duplicate name.

        A duplicate stops everything, since the same program would then mean two things.
        """
        try:
            plugin = load_plugin(reference)
            installed = Installed(plugin, plugin.manifest(), reference)
        except PluginError as error:
            self.problems.append(str(error))
            return
        device_type = installed.manifest.device.type
        rival = self.by_driver.get(plugin.name) or self.for_type(device_type)
        if rival is not None:
            what = "driver" if rival.plugin.name == plugin.name else "device type"
            name = plugin.name if what == "driver" else device_type
            raise PluginError(
                f"two installed plugins, {rival.reference} and {reference}, "
                f"both define the {what} '{name}'; uninstall one of them"
            )
        self.by_driver[plugin.name] = installed


def discover(entries: Iterable[EntryPoint] | None = None) -> Plugins:
    """Every installed driver. No vendor library is imported. Raises PluginError on duplicate names."""
    plugins = Plugins()
    found = entry_points(group=GROUP) if entries is None else entries
    # One distribution may be seen twice (an editable install beside a wheel): the same value is one plugin.
    for reference in sorted({entry.value for entry in found}):
        plugins.add(reference)
    return plugins
