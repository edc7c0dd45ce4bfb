"""The data of a plugin's package under its entry point: import paths only, so that discovery is quick.

Only `read_manifests` reads YAML, on the development computer. A guard receives its manifests from its host,
and checks that they match those of the installed driver.
"""

from __future__ import annotations

import hashlib
import importlib
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfield.errors import DeviceError, MissionFileError, PluginError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lfield.driver.binding import DeviceBinding
    from lfield.driver.contract import Manifest
    from lfield.driver.device import Driver
    from lfield.driver.driver_index import DriverInfo, ManifestFile
    from lfield.geodata.mission_files import PlanReport, PlanRequest
    from lfield.text.source_text import Diagnostic


@dataclass(frozen=True, slots=True)
class Plugin:
    """One driver: `PLUGIN = Plugin("servo", "lfield_servo", "lfield_servo.driver:ServoDriver", ...)`.

    `package` holds a manifest for each device type, the folder `L` with the L sources that missions include
    as `<servo/gripper.L>`, and optionally `capabilities.yaml` for these. `driver` is the path of the driver's
    class and `kit` the path of its conformance kit (`package.kit:KIT`); both are imported only where they
    run. `extra` is the extra of lfield that installs the vendor modules in `requires`, '' for a third-party
    driver.

    Five optional functions run when missions are built, and open no device ('' for none). `endpoint` parses
    the text of an endpoint and raises DeviceError for an invalid one. `conflicts` takes all bindings of the
    driver in a mission and returns those that exclude others, each with a sentence. `files` takes the name of
    an option of type `path` and the file and returns the mistakes in the file, each with its position; it
    raises DeviceError for a file that cannot be read. `plans` takes the name and the bytes of a mission file
    and a PlanRequest and returns a PlanReport; it raises MissionFileError for a file that is not readable.
    `plan_texts` takes the name and the bytes and returns the text that replaces the name in a program.
    """

    name: str
    package: str
    driver: str
    extra: str = ""
    requires: tuple[str, ...] = ()
    manifests: tuple[str, ...] = ("manifest.yaml",)
    kit: str = ""
    endpoint: str = ""
    conflicts: str = ""
    files: str = ""
    plans: str = ""
    plan_texts: str = ""

    @property
    def missing(self) -> list[str]:
        """The vendor modules that are not installed; none is imported."""
        return [vendor for vendor in self.requires if find_spec(vendor) is None]

    @property
    def to_install(self) -> str:
        """The command that installs missing modules."""
        if self.extra:
            return f"pip install 'lfield[{self.extra}]'"
        return f"pip install {' '.join(self.missing or self.requires)}"

    def manifest_bytes(self, file: str) -> bytes:
        """The bytes of an installed manifest file. Raises PluginError."""
        from importlib.resources import files

        try:
            return (files(self.package) / file).read_bytes()
        except (OSError, ImportError) as error:
            raise PluginError(f"driver '{self.name}' has no readable {file}: {error}") from None

    def manifest_digest(self, file: str) -> bytes:
        """The SHA-256 of a manifest file, which identifies the version of the driver's contract."""
        return hashlib.sha256(self.manifest_bytes(file)).digest()

    def has_manifest(self, file: ManifestFile) -> bool:
        """Whether the driver has the contract of a manifest file. Raises PluginError without such a file."""
        return self.manifest_digest(file.name) == file.digest

    def read_manifests(self) -> dict[str, Manifest]:
        """The manifests by device type. Raises PluginError."""
        return {manifest.device.type: manifest for manifest in self.manifest_files().values()}

    def manifest_files(self) -> dict[str, Manifest]:
        """The manifests by file name. Raises PluginError."""
        read = {file: self._manifest(file) for file in self.manifests}
        if len({manifest.device.type for manifest in read.values()}) < len(read):
            raise PluginError(f"driver '{self.name}' has two manifests of one device type")
        return read

    def _manifest(self, file: str) -> Manifest:
        # Imported here, because only the development computer reads manifests, but every driver process loads
        # this module.
        from lfield.driver.manifest_file import load_manifest

        manifest = load_manifest(f"{self.package}/{file}", self.manifest_bytes(file))
        if manifest.device.driver != self.name:
            raise PluginError(f"driver '{self.name}' has the manifest of '{manifest.device.driver}'")
        return manifest

    @property
    def capabilities(self) -> Path | None:
        """The capability registry file of the plugin, None without one."""
        from importlib.resources import files

        path = Path(str(files(self.package))) / "capabilities.yaml"
        return path if path.is_file() else None

    def source(self, file: str) -> Path | None:
        """The L source that a program includes as `<NAME/file>`, None when there is none."""
        from importlib.resources import files

        path = Path(str(files(self.package))) / "L" / file
        return path if path.is_file() else None

    def sources(self) -> list[str]:
        """The names of the L sources that programs can include."""
        from importlib.resources import files

        return sorted(path.name for path in (Path(str(files(self.package))) / "L").glob("*.L"))

    def load(self) -> type[Driver]:
        """Imports the driver class with its vendor library. Raises PluginError that names the package to
        install.
        """
        driver: type[Driver] = self._load(self.driver)
        return driver

    def load_kit(self) -> Any:
        """Imports the conformance kit with its vendor library. Raises PluginError, also when there is
        none.
        """
        if not self.kit:
            raise PluginError(f"driver '{self.name}' has no conformance kit")
        return self._load(self.kit)

    def why_no_endpoint(self, text: str) -> str:
        """The reason why a text is not a valid endpoint; '' if it is, or if only opening it would show this.

        Raises PluginError if the driver itself fails.
        """
        if not self.endpoint or self.missing:
            return ""  # The vendor modules of its robots may be missing on the development computer.
        parse = self._named(self.endpoint)
        try:
            parse(text)
        except DeviceError as error:
            return error.reason
        except Exception as error:  # third-party code, as below
            raise PluginError(f"driver '{self.name}' cannot parse the endpoint '{text}': {error}") from error
        return ""

    def conflicts_of(self, bindings: Sequence[DeviceBinding]) -> list[tuple[DeviceBinding, str]]:
        """The bindings of a mission that exclude others, each with a sentence.

        Raises PluginError if the driver itself fails.
        """
        if not self.conflicts or self.missing:
            return []
        find = self._named(self.conflicts)
        try:
            return list(find(bindings))
        except Exception as error:  # third-party code, as below
            raise PluginError(f"driver '{self.name}' cannot compare its bindings: {error}") from error

    def mistakes_in(self, option: str, file: str) -> list[Diagnostic]:
        """The mistakes in a file that an option of a binding names.

        Raises DeviceError for a file that cannot be read, PluginError if the driver itself fails.
        """
        if not self.files or self.missing:
            return []
        find = self._named(self.files)
        try:
            return list(find(option, file))
        except DeviceError:
            raise
        except Exception as error:  # third-party code, as below
            raise PluginError(f"driver '{self.name}' cannot read {file}: {error}") from error

    def read_plan(self, name: str, data: bytes, request: PlanRequest) -> PlanReport:
        """The contents of a mission file, checked for a vehicle.

        Raises MissionFileError, PluginError without such a function or without its vendor modules.
        """
        report: PlanReport = self._read_file(self.plans, name, data, request)
        return report

    def plan_text(self, name: str, data: bytes) -> str:
        """The text of a mission file for a program. Raises MissionFileError, PluginError."""
        text: str = self._read_file(self.plan_texts, name, data)
        return text

    def _read_file(self, path: str, name: str, *arguments: object) -> Any:
        if not path:
            raise PluginError(f"driver '{self.name}' reads no mission files")
        read = self._load(path)
        try:
            return read(name, *arguments)
        except MissionFileError:
            raise
        except Exception as error:  # third-party code, as below
            raise PluginError(f"driver '{self.name}' cannot read {name}: {error}") from error

    def _load(self, path: str) -> Any:
        missing = [vendor for vendor in self.requires if not _importable(vendor)]
        if missing:
            raise PluginError(f"driver '{self.name}' needs {', '.join(missing)}: {self.to_install}")
        return self._named(path)

    def _named(self, path: str) -> Any:
        module, _, name = path.partition(":")
        try:
            return getattr(importlib.import_module(module), name)
        except Exception as error:  # third-party code: an import may raise any exception
            raise PluginError(f"driver '{self.name}' cannot be loaded from {path}: {error}") from error


def _importable(vendor: str) -> bool:
    try:
        importlib.import_module(vendor)
    except ImportError:
        return False
    return True


def load_plugin(reference: str) -> Plugin:
    """The plugin at `package:NAME`. Raises PluginError."""
    module, _, name = reference.partition(":")
    try:
        plugin = getattr(importlib.import_module(module), name)
    except Exception as error:  # third-party code, as above
        raise PluginError(f"the driver plugin '{reference}' cannot be imported: {error}") from error
    if not isinstance(plugin, Plugin):
        raise PluginError(f"the driver plugin '{reference}' is not an lfield.driver.Plugin")
    return plugin


def check_same(known: DriverInfo, plugin: Plugin) -> None:
    """Raises PluginError unless the installed driver has the contract that the mission was built with."""
    for file in known.files.values():
        if not plugin.has_manifest(file):
            raise PluginError(
                f"the installed driver '{known.name}' is not the one that the mission was built with "
                f"({file.name} differs): install {known.to_install}, or build the mission again with the "
                "driver of its robots"
            )


def conflicts_of(known: DriverInfo, bindings: Sequence[DeviceBinding]) -> list[tuple[DeviceBinding, str]]:
    """The bindings of a driver that exclude others; empty if the driver is not installed."""
    plugin = _installed(known)
    return plugin.conflicts_of(bindings) if plugin is not None else []


def mistakes_in(known: DriverInfo, option: str, file: str) -> list[Diagnostic]:
    """The mistakes in a file that an option names; empty if the driver is not installed.

    Raises DeviceError for a file that cannot be read.
    """
    plugin = _installed(known)
    return plugin.mistakes_in(option, file) if plugin is not None else []


def why_no_endpoint(known: DriverInfo, text: str) -> str:
    """The reason why a text is no valid endpoint of a driver; '' if it is, or the driver is not installed."""
    plugin = _installed(known)
    return plugin.why_no_endpoint(text) if plugin is not None else ""


def _installed(known: DriverInfo) -> Plugin | None:
    """The plugin of a driver; None if it is not installed, which is possible on the development computer."""
    try:
        return load_plugin(known.reference)
    except PluginError:
        return None
