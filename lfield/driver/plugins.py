"""Finds the installed driver plugins by their entry points (`lfield.drivers.v1`) and reads their manifests.

For the desk: a robot gets what it must know of its drivers with the mission (lfield.driver.known).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path, PurePosixPath

from lfield.driver.known import GROUP, KnownDriver, ManifestFile
from lfield.driver.plugin import Plugin, load_plugin
from lfield.errors import PluginError
from lfield.manifest import DeviceManifest


@dataclass(frozen=True, slots=True)
class Installed(KnownDriver):
    """One usable plugin with what is known of it."""

    plugin: Plugin


def _installed(reference: str, distribution: str) -> Installed:
    plugin = load_plugin(reference)
    read = plugin.manifest_files()
    return Installed(
        name=plugin.name,
        reference=reference,
        manifests={manifest.device.type: manifest for manifest in read.values()},
        files={m.device.type: ManifestFile(file, plugin.manifest_digest(file)) for file, m in read.items()},
        distribution=distribution,
        plugin=plugin,
    )


@dataclass(slots=True)
class Plugins:
    """What is installed, and a sentence for each plugin that cannot be used."""

    by_driver: dict[str, Installed] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)

    @property
    def device_types(self) -> dict[str, DeviceManifest]:
        """Device types by their name in L, as the compiler needs them."""
        return {
            name: manifest.device
            for found in self.by_driver.values()
            for name, manifest in found.manifests.items()
        }

    @property
    def capabilities(self) -> list[Path]:
        """What the drivers say in registry files of the resource types that they bring, in a fixed order."""
        found = (installed.plugin.capabilities for _, installed in sorted(self.by_driver.items()))
        return [path for path in found if path is not None]

    def for_type(self, device_type: str) -> Installed | None:
        """The plugin of a device type."""
        return next((found for found in self.by_driver.values() if device_type in found.manifests), None)

    def find_source(self, path: str) -> Path | None:
        """The file of `include <driver/name.L>;`, or None when no installed driver ships it."""
        driver, _, file = path.partition("/")
        found = self.by_driver.get(driver)
        # One folder, no way out of it: the rest is a plain file name.
        if found is None or PurePosixPath(file).name != file or file in ("", ".", ".."):
            return None
        return found.plugin.source(file)

    def add(self, reference: str, distribution: str = "") -> None:
        """Take a plugin in, or note why it cannot be. Raises PluginError on a duplicate name.

        A duplicate stops everything, since the same program would then mean two things. `distribution` is
        what was installed to have it.
        """
        try:
            installed = _installed(reference, distribution)
        except PluginError as error:
            self.problems.append(str(error))
            return
        if (rival := self.by_driver.get(installed.name)) is not None:
            raise _both(rival.reference, reference, f"the driver '{installed.name}'")
        for device_type in installed.manifests:
            if (rival := self.for_type(device_type)) is not None:
                raise _both(rival.reference, reference, f"the device type '{device_type}'")
        self.by_driver[installed.name] = installed


def _both(first: str, second: str, what: str) -> PluginError:
    return PluginError(
        f"two installed plugins, {first} and {second}, both define {what}; uninstall one of them"
    )


def discover(entries: Iterable[EntryPoint] | None = None) -> Plugins:
    """Every installed driver. No vendor library is imported. Raises PluginError on duplicate names."""
    plugins = Plugins()
    found = entry_points(group=GROUP) if entries is None else entries
    # One distribution may be seen twice (an editable install beside a wheel): the same value is one plugin.
    for reference, entry in sorted({entry.value: entry for entry in found}.items()):
        plugins.add(reference, f"{entry.dist.name} {entry.dist.version}" if entry.dist else "")
    return plugins
