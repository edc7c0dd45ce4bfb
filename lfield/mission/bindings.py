"""The device bindings of a mission, checked as a whole (the file is described in `bindings_file`).

Nothing is commanded from a default: a needed device that is not bound is an error, unless the mission is
simulated; then it gets a fake.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.driver.plugins import Installed, Plugins
from lfield.errors import BindingError
from lfield.mission.bindings_file import Bindings, BindingsReader, Needed
from lfield.text.source import Diagnostics
from lfield.text.yaml_source import read

__all__ = ["Bindings", "Needed", "read_bindings"]


def read_bindings(path: Path | None, needed: Needed, plugins: Plugins, *, simulate: bool = False) -> Bindings:
    """The bindings in a file (None: there is no file), checked against what the mission needs.

    With `simulate`, needed devices that are not bound get defaults, and every endpoint is SIMULATED.
    Raises BindingError with all problems, InputFileError when the file cannot be read.
    """
    found = Diagnostics()
    node = read(str(path), found) if path is not None else None
    bindings = Bindings()
    if path is not None and node is not None:
        bindings = BindingsReader(needed, plugins, found, path.parent, simulate=simulate).bindings(node)
    problems = [diagnostic.render() for diagnostic in found.errors]
    problems += _without_driver(needed, plugins)
    # What is written wrong is not missing: the file's own errors are told first, and alone.
    if not simulate and not found.errors:
        problems += _unbound(bindings, needed, plugins, path)
    if problems:
        raise BindingError(problems)
    return _simulated(bindings, needed, plugins) if simulate else bindings


def _devices(needed: Needed) -> Iterator[tuple[str, str, str]]:
    """Agent, field and device type of every needed device."""
    for agent, fields in needed.items():
        for name, device_type in fields.items():
            yield agent, name, device_type


def _without_driver(needed: Needed, plugins: Plugins) -> list[str]:
    installed = ", ".join(sorted(plugins.device_types)) or "none"
    return [
        f"{agent}.{name}: no installed driver makes a {device_type} (device types installed: {installed})"
        for agent, name, device_type in _devices(needed)
        if plugins.for_type(device_type) is None
    ]


def _unbound(bindings: Bindings, needed: Needed, plugins: Plugins, path: Path | None) -> list[str]:
    where = f"in {path}" if path else "and there is no devices file"
    return [
        f"{agent}.{name} ({device_type}) is not bound {where}: add 'devices: {{{name}: {{driver: "
        f"{installed.plugin.name}, endpoint: ...}}}}' under the agent '{agent}', or use --sim"
        for agent, name, device_type in _devices(needed)
        if name not in bindings.devices.get(agent, {}) and (installed := plugins.for_type(device_type))
    ]


def _simulated(bindings: Bindings, needed: Needed, plugins: Plugins) -> Bindings:
    """Every needed device on a fake, with the limits and options of the file where it has them."""
    devices: dict[str, dict[str, DeviceBinding]] = {agent: {} for agent in needed}
    for agent, name, device_type in _devices(needed):
        installed = plugins.for_type(device_type)
        assert installed is not None, "_without_driver has told"
        bound = bindings.devices.get(agent, {}).get(name)
        devices[agent][name] = bound or _fake_binding(agent, name, device_type, installed)
    return replace(bindings, devices=devices)


def _fake_binding(agent: str, name: str, device_type: str, installed: Installed) -> DeviceBinding:
    """A device that nobody has bound, on a fake of its own: there is nothing that could be hurt."""
    manifest = installed.manifests[device_type]
    return DeviceBinding(
        agent=agent,
        field=name,
        type=device_type,
        driver=installed.plugin.name,
        endpoint=f"{SIMULATED}{agent}.{name}",
        safe_state=manifest.default_safe_state,
        options={o.name: o.default for o in manifest.options if o.default is not None},
        waivers=[waiver for waiver, _ in manifest.waivers],
    )
