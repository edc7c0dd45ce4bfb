"""What a plugin's package offers under its entry point: names only, so that looking costs nothing.

Nothing here reads YAML but `read_manifests`, which is for the desk: a guard gets its manifests from its host,
and only sees to it that they are those of the driver it runs.
"""

from __future__ import annotations

import hashlib
import importlib
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfield.errors import DeviceError, PluginError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lfield.driver.binding import DeviceBinding
    from lfield.driver.contract import Manifest
    from lfield.driver.device import Driver
    from lfield.driver.known import KnownDriver
    from lfield.text.source import Diagnostic


@dataclass(frozen=True, slots=True)
class Plugin:
    """One driver: `PLUGIN = Plugin("servo", "lfield_servo", "lfield_servo.driver:ServoDriver", ...)`.

    `package` holds a manifest for each device type, and the folder `L` with the L sources that missions
    include as `<servo/gripper.L>`, and may hold a `capabilities.yaml`: what these can do. `driver` is the
    path of the driver's class and `kit` that of its conformance kit (`package.kit:KIT`), both imported only
    where they run; `extra` is that of lfield with the vendor modules in `requires`, '' for a driver of one's
    own. `endpoint` is the path of a function that parses the text of an endpoint and raises DeviceError for
    one that is none: it opens nothing, and runs where missions are built; '' where only opening one tells.
    `conflicts` is the path of a function that takes all bindings of the driver in a mission, and gives those
    that cannot be beside the others, each with a sentence; it runs there too, '' for none. `files` is the
    path of a function that takes the name of an option of type `path` and the file, and gives the mistakes in
    the file, each with its place; it raises DeviceError for a file that cannot be read; it runs there too, ''
    where only opening tells.
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

    @property
    def missing(self) -> list[str]:
        """The vendor modules that are not installed; none of them is imported."""
        return [vendor for vendor in self.requires if find_spec(vendor) is None]

    @property
    def to_install(self) -> str:
        """The command that installs what may be missing."""
        if self.extra:
            return f"pip install 'lfield[{self.extra}]'"
        return f"pip install {' '.join(self.missing or self.requires)}"

    def manifest_bytes(self, file: str) -> bytes:
        """One of its manifest files as it is installed. Raises PluginError."""
        from importlib.resources import files

        try:
            return (files(self.package) / file).read_bytes()
        except (OSError, ImportError) as error:
            raise PluginError(f"driver '{self.name}' has no readable {file}: {error}") from None

    def manifest_digest(self, file: str) -> bytes:
        """SHA-256 of a manifest file: by it the driver here is held against the one of the desk."""
        return hashlib.sha256(self.manifest_bytes(file)).digest()

    def read_manifests(self) -> dict[str, Manifest]:
        """The manifests by device type, read now. Raises PluginError."""
        return {manifest.device.type: manifest for manifest in self.manifest_files().values()}

    def manifest_files(self) -> dict[str, Manifest]:
        """The same by the files that hold them. Raises PluginError."""
        read = {file: self._manifest(file) for file in self.manifests}
        if len({manifest.device.type for manifest in read.values()}) < len(read):
            raise PluginError(f"driver '{self.name}' has two manifests of one device type")
        return read

    def _manifest(self, file: str) -> Manifest:
        # Here, since only the desk reads manifests; every process that runs a driver has this module.
        from lfield.driver.manifest_file import load_manifest

        manifest = load_manifest(f"{self.package}/{file}", self.manifest_bytes(file))
        if manifest.device.driver != self.name:
            raise PluginError(f"driver '{self.name}' has the manifest of '{manifest.device.driver}'")
        return manifest

    @property
    def capabilities(self) -> Path | None:
        """What its package says of its resource types in a registry file, None when it says nothing."""
        from importlib.resources import files

        path = Path(str(files(self.package))) / "capabilities.yaml"
        return path if path.is_file() else None

    def source(self, file: str) -> Path | None:
        """The L source that a program includes as `<NAME/file>`, or None when the plugin ships none such."""
        from importlib.resources import files

        path = Path(str(files(self.package))) / "L" / file
        return path if path.is_file() else None

    def load(self) -> type[Driver]:
        """The driver class, with its vendor library. Raises PluginError that says what to install."""
        driver: type[Driver] = self._load(self.driver)
        return driver

    def load_kit(self) -> Any:
        """The conformance kit, with the vendor library. Raises PluginError, also when there is none."""
        if not self.kit:
            raise PluginError(f"driver '{self.name}' has no conformance kit")
        return self._load(self.kit)

    def why_no_endpoint(self, text: str) -> str:
        """Why a text is no endpoint of its, as far as that is known unopened; '' for one.

        Raises PluginError where the driver does not say so but breaks.
        """
        if not self.endpoint or self.missing:
            return ""  # A desk need not have the vendor modules of its robots.
        parse = self._named(self.endpoint)
        try:
            parse(text)
        except DeviceError as error:
            return error.reason
        except Exception as error:  # foreign code, as below
            raise PluginError(f"driver '{self.name}' cannot parse the endpoint '{text}': {error}") from error
        return ""

    def conflicts_of(self, bindings: Sequence[DeviceBinding]) -> list[tuple[DeviceBinding, str]]:
        """The bindings of a mission that cannot be beside the others, each with a sentence.

        Raises PluginError where the driver breaks instead of telling.
        """
        if not self.conflicts or self.missing:
            return []
        find = self._named(self.conflicts)
        try:
            return list(find(bindings))
        except Exception as error:  # foreign code, as below
            raise PluginError(f"driver '{self.name}' cannot compare its bindings: {error}") from error

    def mistakes_in(self, option: str, file: str) -> list[Diagnostic]:
        """The mistakes in a file that an option of a binding names.

        Raises DeviceError for a file that cannot be read, PluginError where the driver breaks.
        """
        if not self.files or self.missing:
            return []
        find = self._named(self.files)
        try:
            return list(find(option, file))
        except DeviceError:
            raise
        except Exception as error:  # foreign code, as below
            raise PluginError(f"driver '{self.name}' cannot read {file}: {error}") from error

    def _load(self, path: str) -> Any:
        missing = [vendor for vendor in self.requires if not _importable(vendor)]
        if missing:
            raise PluginError(f"driver '{self.name}' needs {', '.join(missing)}: {self.to_install}")
        return self._named(path)

    def _named(self, path: str) -> Any:
        module, _, name = path.partition(":")
        try:
            return getattr(importlib.import_module(module), name)
        except Exception as error:  # a plugin is foreign code: whatever it raises on import is its fault
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
    except Exception as error:  # as above: foreign code
        raise PluginError(f"the driver plugin '{reference}' cannot be imported: {error}") from error
    if not isinstance(plugin, Plugin):
        raise PluginError(f"the driver plugin '{reference}' is not a lfield.driver.Plugin")
    return plugin


def check_same(known: KnownDriver, plugin: Plugin) -> None:
    """Raise PluginError unless the installed driver promises what the mission was built with."""
    for file in known.files.values():
        if plugin.manifest_digest(file.name) != file.digest:
            raise PluginError(
                f"the driver '{known.name}' that is installed here is not the one the mission was built with "
                f"({file.name} differs): install {known.to_install} here, or build the mission again with "
                "the driver that its robots have"
            )


def conflicts_of(known: KnownDriver, bindings: Sequence[DeviceBinding]) -> list[tuple[DeviceBinding, str]]:
    """The bindings of a driver that cannot be beside the others; none where it is not installed here."""
    plugin = _installed(known)
    return plugin.conflicts_of(bindings) if plugin is not None else []


def mistakes_in(known: KnownDriver, option: str, file: str) -> list[Diagnostic]:
    """The mistakes in a file that an option names; none where the driver is not installed here.

    Raises DeviceError for a file that cannot be read.
    """
    plugin = _installed(known)
    return plugin.mistakes_in(option, file) if plugin is not None else []


def why_no_endpoint(known: KnownDriver, text: str) -> str:
    """Why a text is no endpoint of a driver; '' for one, and where the driver is not installed here."""
    plugin = _installed(known)
    return plugin.why_no_endpoint(text) if plugin is not None else ""


def _installed(known: KnownDriver) -> Plugin | None:
    """The plugin of a driver; None where it is not installed: a desk may lack drivers of its robots."""
    try:
        return load_plugin(known.reference)
    except PluginError:
        return None
