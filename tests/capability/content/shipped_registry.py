"""The shipped registry, read once, and the device types of the three drivers."""

from __future__ import annotations

from pathlib import Path

import lfield_can
import lfield_dynamixel
import lfield_mavlink
from lfield.capability.registry_reader.registry_files import read_registry
from lfield.manifest import DeviceManifest

REGISTRY = read_registry()

PLUGINS = {
    "can": lfield_can.PLUGIN,
    "dynamixel": lfield_dynamixel.PLUGIN,
    "mavlink": lfield_mavlink.PLUGIN,
}

#: Every device type of the drivers.
DEVICES: dict[str, DeviceManifest] = {
    name: manifest.device for plugin in PLUGINS.values() for name, manifest in plugin.read_manifests().items()
}


def stock_source(include: str) -> Path:
    """The file of `include <can/winch.L>;`."""
    driver, _, name = include.partition("/")
    path = PLUGINS[driver].source(name)
    assert path is not None, include
    return path


def find_include(include: str) -> Path | None:
    """The include search of the front end for angle brackets."""
    driver, _, name = include.partition("/")
    return PLUGINS[driver].source(name) if driver in PLUGINS else None
