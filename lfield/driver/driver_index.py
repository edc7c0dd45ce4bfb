"""Metadata of a driver without its code, sufficient to run its devices behind a guard.

Read from the installed plugins on the development computer (`plugins.discover`). A bundle transports them to
the robots, which only check that the installed driver has the same name and contract.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

from lfield.driver.contract import Manifest
from lfield.errors import PluginError

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

#: The entry-point group of installed drivers.
GROUP = "lfield.drivers.v1"


def entry_points(group: str) -> tuple[EntryPoint, ...]:
    """The installed entry points of a group.

    The metadata of all distributions is read only once, and again after a package has been installed or
    removed in a folder of `sys.path`.
    """
    return _read_entry_points(group, tuple((path, _last_change(path)) for path in sys.path))


@lru_cache(maxsize=4)
def _read_entry_points(group: str, _: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    # Imported here, because the module loads slowly and many hosts do not need it.
    from importlib import metadata

    return tuple(metadata.entry_points(group=group))


def _last_change(folder: str) -> int:
    """The time (ns) of the last change of a folder, 0 without one."""
    with suppress(OSError):
        return os.stat(folder or ".").st_mtime_ns
    return 0


@lru_cache(maxsize=64)
def distribution_title(distribution: Distribution) -> str:
    """The name and the version of a distribution."""
    return f"{distribution.name} {distribution.version}"


@dataclass(frozen=True, slots=True)
class ManifestFile:
    """A manifest file in its plugin's package, with the SHA-256 of its bytes."""

    name: str
    digest: bytes


@dataclass(frozen=True, slots=True)
class DriverInfo:
    """One driver. `reference` (`package:PLUGIN`) is the import path of its plugin.

    `manifests` and their `files` are by device type; `distribution` is the package to install ('' if
    unknown).
    """

    name: str
    reference: str
    manifests: Mapping[str, Manifest]
    files: Mapping[str, ManifestFile]
    distribution: str

    def for_types(self, types: Collection[str]) -> DriverInfo:
        """The metadata of the given device types only."""
        manifests = {name: manifest for name, manifest in self.manifests.items() if name in types}
        files = {name: file for name, file in self.files.items() if name in types}
        return DriverInfo(self.name, self.reference, manifests, files, self.distribution)

    @property
    def without_local_parts(self) -> DriverInfo:
        """A copy without data of this computer."""
        return self.for_types(self.manifests.keys())

    @property
    def to_install(self) -> str:
        """The package to install, in words."""
        return self.distribution or f"the package of {self.reference}"


class DriverLookup(Protocol):
    """Provides drivers by name."""

    @property
    def by_driver(self) -> Mapping[str, DriverInfo]:
        """The drivers by name."""


@dataclass(frozen=True, slots=True)
class DriverIndex:
    """The drivers of a mission by name."""

    by_driver: Mapping[str, DriverInfo]


def installed_drivers(
    drivers: DriverLookup, names: Collection[str], entries: Iterable[EntryPoint] | None = None
) -> DriverIndex:
    """The named drivers with their import paths on this computer, without an import.

    Raises PluginError for a driver that is not installed.
    """
    if not names:
        return DriverIndex({})
    found = {entry.name: entry.value for entry in (entry_points(GROUP) if entries is None else entries)}
    return DriverIndex({name: _installed(drivers.by_driver[name], found) for name in names})


def _installed(driver: DriverInfo, found: Mapping[str, str]) -> DriverInfo:
    """Finds a driver by its name, else by the import path recorded at build time."""
    if driver.name in found:
        return replace(driver, reference=found[driver.name])
    if driver.reference in found.values():
        return driver
    raise PluginError(f"driver '{driver.name}' is not installed: install {driver.to_install}")
