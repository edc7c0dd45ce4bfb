"""What is known of a driver without its code: enough to run its devices behind a guard.

On the desk it is read from the installed plugins (`plugins.discover`); a bundle carries it to the robots,
where an installed driver only has to be found by its name, and to be the same one.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from lfield.driver.contract import Manifest
from lfield.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: Where installed drivers announce themselves.
GROUP = "lfield.drivers.v1"


@dataclass(frozen=True, slots=True)
class ManifestFile:
    """The file of a manifest in its plugin's package, and the SHA-256 of its bytes."""

    name: str
    digest: bytes


@dataclass(frozen=True, slots=True)
class KnownDriver:
    """One driver. `reference` (`package:PLUGIN`) is where its plugin is imported from.

    `manifests` and their `files` are by device type; `distribution` is what to install to have the driver
    ('' where that is not known).
    """

    name: str
    reference: str
    manifests: Mapping[str, Manifest]
    files: Mapping[str, ManifestFile]
    distribution: str

    def only(self, types: Collection[str]) -> KnownDriver:
        """What some device types need of it."""
        manifests = {name: manifest for name, manifest in self.manifests.items() if name in types}
        files = {name: file for name, file in self.files.items() if name in types}
        return KnownDriver(self.name, self.reference, manifests, files, self.distribution)

    @property
    def plain(self) -> KnownDriver:
        """Itself without what only this computer has of it."""
        return self.only(self.manifests.keys())

    @property
    def to_install(self) -> str:
        """What to install, in words."""
        return self.distribution or f"the package of {self.reference}"


class Drivers(Protocol):
    """Whoever knows drivers by their names."""

    @property
    def by_driver(self) -> Mapping[str, KnownDriver]:
        """The drivers by name."""


@dataclass(frozen=True, slots=True)
class KnownDrivers:
    """The drivers of a mission by name."""

    by_driver: Mapping[str, KnownDriver]


def installed_here(
    drivers: Drivers, names: Collection[str], entries: Iterable[EntryPoint] | None = None
) -> KnownDrivers:
    """The drivers of these names, each where it is installed on this computer. Nothing is imported.

    Raises PluginError for one that is not installed.
    """
    if not names:
        return KnownDrivers({})
    if entries is None:
        from importlib.metadata import entry_points

        entries = entry_points(group=GROUP)
    found = {entry.name: entry.value for entry in entries}
    return KnownDrivers({name: _here(drivers.by_driver[name], found) for name in names})


def _here(driver: KnownDriver, found: Mapping[str, str]) -> KnownDriver:
    """A driver by its name, else by the reference that it had where the mission was built."""
    if driver.name in found:
        return replace(driver, reference=found[driver.name])
    if driver.reference in found.values():
        return driver
    raise PluginError(f"driver '{driver.name}' is not installed here: install {driver.to_install}")
