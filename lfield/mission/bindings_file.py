"""Reads `mission.devices.yaml`: limits of agents, and what their devices are bound to.

```yaml
agents:
  alpha:                                   # an agent of the deployment
    heap: 2 MiB                            # limits of this agent
    devices:
      fc:
        driver: mavlink
        endpoint: "udp:127.0.0.1:14550"
        system: 1                          # an option of this driver
        limits: {speed: 5.0}               # SI units; the driver's manifest lists them
        ttl: 0.5                           # seconds that a setpoint lasts
        safe_state: land
        waivers: [device_watchdog]         # protections that are knowingly given up
        sim: ["battery=0.5"]               # of its fake, with --sim: see `lfield sim fault`
defaults: {heap: 1 MiB, call_depth: 500}   # limits of every agent
unreachable_after: 10                      # seconds until UnreachableResourceException
silence: 0.2                               # seconds without the host after which its devices go safe
```

The keys of a device that every driver has are `driver`, `endpoint`, `ttl`, `safe_state`, `limits`, `waivers`,
`sim` and, for those who read it, `type`; the rest are the driver's own options. What fits no agent, device,
driver or type is an error, all of them at once, each drawn at its place.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from lfield.driver.binding import SIMULATED, DeviceBinding, OptionValue
from lfield.driver.contract import Manifest, Option
from lfield.driver.plugins import Plugins
from lfield.guard.core import SILENCE
from lfield.text.source import Diagnostics
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Entry, Node, Scalar, describe
from lfield.vm.contract import Limits

#: Agent id -> field name -> device type: what a mission needs. Every agent is a key, also without devices.
Needed = Mapping[str, Mapping[str, str]]

#: A heap is addressed by 32-bit offsets; below a page not even an empty agent fits.
MIN_HEAP, MAX_HEAP = 1 << 12, 1 << 31

_UNITS = {"B": 1, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
_SIZE = re.compile(r"([0-9]{1,12})\s*(B|KiB|MiB|GiB)")


@dataclass(frozen=True, slots=True)
class Bindings:
    """What a devices file says: limits of agents, and devices by agent and field."""

    agents: Mapping[str, Limits] = field(default_factory=dict)
    devices: Mapping[str, Mapping[str, DeviceBinding]] = field(default_factory=dict)
    defaults: Limits = field(default_factory=Limits)
    unreachable_after: float = 10.0
    silence: float = SILENCE

    def limits(self, agent: str) -> Limits:
        """The limits of an agent: its own, then the defaults of the file, then the machine's."""
        return self.agents.get(agent, self.defaults)

    def of(self, agents: Collection[str]) -> list[DeviceBinding]:
        """Every device of these agents, as the guards of their host need them."""
        return [device for agent in agents for device in self.devices.get(agent, {}).values()]


class BindingsReader:
    """One pass over a devices file; findings go to `found`."""

    def __init__(
        self, needed: Needed, plugins: Plugins, found: Diagnostics, folder: Path, *, simulate: bool
    ) -> None:
        self._needed, self._plugins, self._found = needed, plugins, found
        self._folder, self._simulate = folder, simulate

    def bindings(self, node: Node) -> Bindings:
        """The whole file; findings go to the diagnostics."""
        top = Fields(node, self._found, "a devices file")
        section = top.section("defaults")
        defaults = self._limits(section, Limits())
        section.done()
        unreachable_after = top.number("unreachable_after", 10.0, minimum=0.1, maximum=86400.0)
        silence = top.number("silence", SILENCE, minimum=0.1, maximum=10.0)
        agents: dict[str, Limits] = {}
        devices: dict[str, dict[str, DeviceBinding]] = {}
        for entry, fields in top.section("agents").entries():
            if entry.key not in self._needed:
                hint = f"its agents: {', '.join(sorted(self._needed)) or 'none'}"
                fields.report("Y113", f"the deployment has no agent '{entry.key}'", entry.key_span, hint)
                continue
            agents[entry.key] = self._limits(fields, defaults)
            devices[entry.key] = dict(self._devices(entry.key, fields))
            fields.done()
        top.done()
        return Bindings(agents, devices, defaults, unreachable_after, silence)

    def _limits(self, fields: Fields, defaults: Limits) -> Limits:
        return Limits(
            heap=self._size(fields, "heap", defaults.heap),
            call_depth=fields.integer("call_depth", defaults.call_depth, minimum=1, maximum=1 << 20),
            array_length=fields.integer("array_length", defaults.array_length, minimum=1, maximum=1 << 29),
            string_length=fields.integer("string_length", defaults.string_length, minimum=1, maximum=1 << 31),
            threads=fields.integer("threads", defaults.threads, minimum=1, maximum=1 << 16),
        )

    def _size(self, fields: Fields, key: str, default: int) -> int:
        node = fields.node(key)
        if node is None:
            return default
        text = node.value if isinstance(node, Scalar) and isinstance(node.value, str) else ""
        match = _SIZE.fullmatch(text)
        size = int(match[1]) * _UNITS[match[2]] if match else 0
        if not MIN_HEAP <= size <= MAX_HEAP:
            message = f"'{key}' must be a size from 4 KiB to 2 GiB, not {describe(node)}"
            fields.report("Y112", message, node.span, "write 512 KiB or 2 MiB")
            return default
        return size

    def _devices(self, agent: str, fields: Fields) -> list[tuple[str, DeviceBinding]]:
        bound = []
        for entry, device in fields.section("devices").entries():
            binding = self._device(agent, entry, device)
            if binding is not None:
                bound.append((entry.key, binding))
        return bound

    def _device(self, agent: str, entry: Entry, fields: Fields) -> DeviceBinding | None:
        """One device; None when it cannot be told what it is."""
        needed = self._needed[agent]
        if entry.key not in needed:
            hint = f"its devices: {', '.join(sorted(needed)) or 'none'}"
            fields.report("Y113", f"{agent} has no device '{entry.key}'", entry.key_span, hint)
            return None
        name = fields.text("driver", required=True)
        installed = self._plugins.by_driver.get(name)
        if installed is None:
            if name:
                hint = f"installed: {', '.join(sorted(self._plugins.by_driver)) or 'none'}"
                fields.report("Y113", f"there is no driver '{name}'", fields.value_span("driver"), hint)
            return None
        manifest = installed.manifests.get(needed[entry.key])
        if manifest is None:
            makes = " or ".join(sorted(installed.manifests))
            message = f"driver '{name}' makes a {makes}, and {entry.key} is a {needed[entry.key]}"
            fields.report("Y113", message, fields.value_span("driver"))
            return None
        fields.text("type", choices=(manifest.device.type,))
        states = manifest.device.safe_states
        binding = DeviceBinding(
            agent=agent,
            field=entry.key,
            type=manifest.device.type,
            driver=name,
            endpoint=self._endpoint(fields, f"{agent}.{entry.key}"),
            ttl=fields.number("ttl", 0.5, minimum=0.02, maximum=60.0),
            safe_state=fields.text("safe_state", manifest.default_safe_state, choices=states),
            limits=self._device_limits(fields, manifest),
            options=self._options(fields, manifest),
            waivers=self._waivers(fields, manifest),
            sim=list(fields.texts("sim")),
        )
        fields.done()
        return binding

    def _endpoint(self, fields: Fields, name: str) -> str:
        endpoint = fields.text("endpoint", required=not self._simulate)
        return f"{SIMULATED}{endpoint or name}" if self._simulate else endpoint

    def _waivers(self, fields: Fields, manifest: Manifest) -> list[str]:
        known = [name for name, _ in manifest.waivers]
        waivers = fields.texts("waivers")
        for waiver in waivers:
            if waiver not in known:
                hint = f"waivers of a {manifest.device.type}: {', '.join(known)}"
                message = f"there is nothing called '{waiver}' to waive"
                fields.report("Y113", message, fields.value_span("waivers"), hint)
        return list(waivers)

    def _device_limits(self, fields: Fields, manifest: Manifest) -> dict[str, float]:
        section = fields.section("limits")
        limits = {
            limit.name: section.number(limit.name, minimum=0.0)
            for limit in manifest.limits
            if limit.name in section
        }
        section.done()
        return limits

    def _options(self, fields: Fields, manifest: Manifest) -> dict[str, OptionValue]:
        options: dict[str, OptionValue] = {}
        for option in manifest.options:
            value = self._option(fields, option)
            if value is not None:
                options[option.name] = value
        return options

    def _path(self, fields: Fields, key: str) -> str:
        """A file as seen from the folder of the devices file."""
        text = fields.text(key)
        path = self._folder / text
        if text and not path.is_file():
            fields.report("Y113", f"there is no file {path}", fields.value_span(key))
        return str(path.resolve()) if text else ""

    def _option(self, fields: Fields, option: Option) -> OptionValue | None:
        required = option.default is None
        if option.name not in fields:
            fields.node(option.name, required=required)
            return option.default
        if option.type == "boolean":
            return fields.flag(option.name)
        if option.type == "string":
            return fields.text(option.name, choices=option.choices)
        if option.type == "path":
            return self._path(fields, option.name)
        if option.type == "int[]":
            return list(fields.integers(option.name))
        if option.type == "string[]":
            return list(fields.texts(option.name))
        if option.type == "real":
            return fields.number(option.name, minimum=option.minimum, maximum=option.maximum)
        lowest, highest = max(option.minimum, -(2.0**63)), min(option.maximum, 2.0**62)
        return fields.integer(option.name, minimum=int(lowest), maximum=int(highest))
