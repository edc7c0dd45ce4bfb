"""Discovers installed driver plugins by their entry points (`lfield.drivers.v1`) and reads their manifests.

Runs on the development computer; a robot receives this data with the mission (lfield.driver.driver_index).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from lfield.driver.driver_index import GROUP, DriverInfo, ManifestFile, distribution_title, entry_points
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import PluginError, UsageError
from lfield.manifest import DeviceManifest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


@dataclass(frozen=True, slots=True)
class InstalledPlugin(DriverInfo):
    """A usable plugin and its metadata."""

    plugin: Plugin


def _installed(reference: str, distribution: str) -> InstalledPlugin:
    plugin = load_plugin(reference)
    read = plugin.manifest_files()
    return InstalledPlugin(
        name=plugin.name,
        reference=reference,
        manifests={manifest.device.type: manifest for manifest in read.values()},
        files={m.device.type: ManifestFile(file, plugin.manifest_digest(file)) for file, m in read.items()},
        distribution=distribution,
        plugin=plugin,
    )


@dataclass(slots=True)
class Plugins:
    """The installed plugins, and a sentence for each that cannot be used."""

    by_driver: dict[str, InstalledPlugin] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def device_types(self) -> dict[str, DeviceManifest]:
        """Device types by their name in L, for the compiler."""
        return {
            name: manifest.device
            for found in self.by_driver.values()
            for name, manifest in found.manifests.items()
        }

    @property
    def capabilities(self) -> list[Path]:
        """The capability registry files of the drivers, in a fixed order."""
        found = (installed.plugin.capabilities for _, installed in sorted(self.by_driver.items()))
        return [path for path in found if path is not None]

    def for_type(self, device_type: str) -> InstalledPlugin | None:
        return next((found for found in self.by_driver.values() if device_type in found.manifests), None)

    @property
    def plan_reader(self) -> Plugin:
        """The driver that reads mission files of ground stations. Raises UsageError without one."""
        readers = [found.plugin for _, found in sorted(self.by_driver.items()) if found.plugin.plans]
        if not readers:
            raise UsageError("no installed driver reads mission files")
        return readers[0]

    def find_source(self, path: str) -> Path | None:
        """The file of `include <driver/name.L>;`, or None when no installed driver ships it."""
        driver, _, file = path.partition("/")
        found = self.by_driver.get(driver)
        # Only a plain file name is accepted, because the path must not leave the folder.
        if found is None or PurePosixPath(file).name != file or file in ("", ".", ".."):
            return None
        return found.plugin.source(file)

    def add(self, reference: str, distribution: str = "") -> None:
        """Adds a plugin, or records the reason why it cannot be used. Raises PluginError on a duplicate name.

        With duplicates the meaning of a program would be ambiguous. `distribution` is the installed package.
        """
        try:
            installed = _installed(reference, distribution)
        except PluginError as error:
            self.problems.append(str(error))
            return
        if (existing := self.by_driver.get(installed.name)) is not None:
            raise _both(existing.reference, reference, f"the driver '{installed.name}'")
        for device_type in installed.manifests:
            if (existing := self.for_type(device_type)) is not None:
                raise _both(existing.reference, reference, f"the device type '{device_type}'")
        self.by_driver[installed.name] = installed


def _both(first: str, second: str, subject: str) -> PluginError:
    return PluginError(
        f"two installed plugins, {first} and {second}, both define {subject}; uninstall one of them"
    )


def discover(entries: Iterable[EntryPoint] | None = None) -> Plugins:
    """Every installed driver. No vendor library is imported. Raises PluginError on duplicate names."""
    plugins = Plugins()
    found = entry_points(GROUP) if entries is None else entries
    # One distribution may be found twice (an editable install and a wheel): equal values are one plugin.
    for reference, entry in sorted({entry.value: entry for entry in found}.items()):
        plugins.add(reference, distribution_title(entry.dist) if entry.dist else "")
    return plugins
