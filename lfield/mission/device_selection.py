"""Selects the devices that `lfield driver test` tries: those of a devices file, or one from the command
line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import msgspec

from lfield.driver.binding import DeviceBinding
from lfield.driver.plugins import InstalledPlugin, Plugins
from lfield.errors import BindingError, UsageError
from lfield.mission.bindings import Bindings, NeededDevices
from lfield.mission.bindings_file import BindingsReader
from lfield.mission.devices_reader.device_bindings import DeviceBindingsReader
from lfield.text.source_text import Diagnostics
from lfield.text.yaml_source import YamlMapping, YamlNode, YamlScalar, decode, read


def devices_in_file(
    path: Path, installed: InstalledPlugin, plugins: Plugins, endpoint: str
) -> list[DeviceBinding]:
    """The devices of a driver in a devices file, at `endpoint` when it is given.

    Raises BindingError, InputFileError, UsageError.
    """
    found = Diagnostics()
    node = read(str(path), found)
    devices = _devices(node, found, plugins, path.parent, installed.plugin.name)
    if not devices:
        raise UsageError(f"{path} binds no device to the driver '{installed.plugin.name}'")
    return [msgspec.structs.replace(device, endpoint=endpoint or device.endpoint) for device in devices]


def one_device(
    installed: InstalledPlugin, plugins: Plugins, endpoint: str, device_type: str, settings: Sequence[str]
) -> list[DeviceBinding]:
    """One device at an endpoint; `settings` are keys of its binding, `KEY=VALUE`. Raises as above."""
    name = installed.plugin.name
    entries = [f"driver: {name}", f"endpoint: {json.dumps(endpoint)}"]
    if device_type:
        entries.append(f"type: {device_type}")
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals:
            raise UsageError(f"--set {setting}: write KEY=VALUE, as in a devices file")
        entries.append(f"{key}: {value}")
    text = "agents:\n  kit:\n    devices:\n      device:\n" + "".join(f"        {e}\n" for e in entries)
    found = Diagnostics()
    node = decode("the command line as a devices file", text.encode(), found)
    return _devices(node, found, plugins, Path(), name)


def _devices(
    node: YamlNode | None, found: Diagnostics, plugins: Plugins, folder: Path, driver: str
) -> list[DeviceBinding]:
    bindings = Bindings()
    if node is not None:
        fields = DeviceBindingsReader(plugins, folder, simulate=False, resources=None)
        reader = BindingsReader(_needed(node, plugins), fields, found)
        bindings = reader.bindings(node)
    if found.errors:
        raise BindingError([diagnostic.render() for diagnostic in found.errors])
    devices = [device for each in bindings.devices.values() for device in each.values()]
    return [device for device in devices if device.driver == driver]


def _needed(node: YamlNode, plugins: Plugins) -> NeededDevices:
    """The types of all devices of the file, as far as the file itself states them."""
    needed: dict[str, dict[str, str]] = {}
    for agent, section in _entries(_child(node, "agents")):
        fields = needed.setdefault(agent, {})
        for name, device in _entries(_child(section, "devices")):
            fields[name] = _type(device, plugins)
    return needed


def _type(device: YamlNode, plugins: Plugins) -> str:
    """The type that a device names, else the only one of its driver; with several it must be given."""
    named, driver = _child(device, "type"), _child(device, "driver")
    if isinstance(named, YamlScalar):
        return str(named.value)
    name = str(driver.value) if isinstance(driver, YamlScalar) else ""
    installed = plugins.by_driver.get(name)
    types = sorted(installed.manifests) if installed is not None else []
    if len(types) > 1:
        raise UsageError(f"a device of the driver '{name}' is a {' or a '.join(types)}: add 'type: ...'")
    return types[0] if types else ""


def _child(node: YamlNode | None, key: str) -> YamlNode | None:
    return node.entries[key].value if isinstance(node, YamlMapping) and key in node.entries else None


def _entries(node: YamlNode | None) -> list[tuple[str, YamlNode]]:
    if not isinstance(node, YamlMapping):
        return []
    return [(entry.key, entry.value) for entry in node.entries.values()]
