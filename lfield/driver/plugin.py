"""What a plugin's package offers under its entry point: names only, so that looking costs nothing."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from lfield.driver.manifest_file import Manifest, load_manifest
from lfield.errors import PluginError

if TYPE_CHECKING:
    from lfield.driver.device import Driver


@dataclass(frozen=True, slots=True)
class Plugin:
    """One driver: `PLUGIN = Plugin("servo", "lfield_servo", "lfield_servo.driver:ServoDriver", ...)`.

    `package` holds `manifest.yaml`; `driver` is the path of the class, imported only in the guard's
    process; `extra` is what to install when one of the vendor modules in `requires` is missing.
    """

    name: str
    package: str
    driver: str
    extra: str
    requires: tuple[str, ...] = ()

    def manifest(self) -> Manifest:
        """The manifest, read now. Raises PluginError."""
        try:
            data = (files(self.package) / "manifest.yaml").read_bytes()
        except (OSError, ImportError) as error:
            raise PluginError(f"driver '{self.name}' has no readable manifest.yaml: {error}") from None
        manifest = load_manifest(f"{self.package}/manifest.yaml", data)
        if manifest.device.driver != self.name:
            raise PluginError(f"driver '{self.name}' has the manifest of '{manifest.device.driver}'")
        return manifest

    def load(self) -> type[Driver]:
        """The driver class, with its vendor library. Raises PluginError that says what to install."""
        module, _, name = self.driver.partition(":")
        try:
            for vendor in self.requires:
                importlib.import_module(vendor)
        except ImportError:
            raise PluginError(
                f"driver '{self.name}' needs {', '.join(self.requires)}: pip install 'lfield[{self.extra}]'"
            ) from None
        try:
            driver: type[Driver] = getattr(importlib.import_module(module), name)
        except Exception as error:  # a plugin is foreign code: whatever it raises on import is its fault
            raise PluginError(f"driver '{self.name}' cannot be loaded from {self.driver}: {error}") from error
        return driver


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
