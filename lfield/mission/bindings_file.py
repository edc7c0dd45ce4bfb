"""Reads `mission.devices.yaml`: limits of agents, and what their devices are bound to.

```yaml
agents:
  alpha:                                   # an agent of the deployment
    heap: 2 MiB                            # limits of this agent
    reserved_wait: 2                       # seconds that others wait for it while it is reserved
    devices:
      fc:
        driver: mavlink
        endpoint: "udp:127.0.0.1:14550"
        system: 1                          # an option of this driver
        limits: {speed: 5.0}               # SI units; the driver's manifest lists them
        ttl: 0.5                           # seconds that a setpoint lasts, and a command may take to begin
        safe_state: land
        rest_within: 120                   # seconds for it to come to rest when its host stops
        without_policy: {after: 30, do: land}    # 30 s without a sign of any coordinator that used it
        waivers: [device_watchdog]         # protections that are knowingly given up
        sim: ["battery=0.5"]               # of its fake, with --sim: see `lfield sim fault`
defaults: {heap: 1 MiB, call_depth: 500}   # limits of every agent
unreachable_after: 10                      # seconds until UnreachableResourceException
silence: 0.2                               # seconds without the host before its devices go safe (fakes: 2)
recovery: {lease: 2, members: [a, b, c]}   # of coordinators that call heartbeatInterval: who
                                           # decides that one is lost, and the seconds it may run unheard
reservations: {lease: 6, wait: 5}          # seconds that a `reserve` lasts without a sign of its holder,
                                           # and that others wait for what is reserved
```

The keys of a device that every driver has are `driver`, `endpoint`, `ttl`, `safe_state`, `rest_within`,
`without_policy`, `limits`, `waivers`, `sim` and, for those who read it, `type`; the rest are the driver's own
options. What fits no agent, device, driver or type is an error, all of them at once, each drawn at its place.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

from lfield.driver.binding import LEAST_AFTER, DeviceBinding, OptionValue, WithoutPolicy
from lfield.driver.contract import Manifest, Option
from lfield.driver.known import Drivers
from lfield.errors import BindingError
from lfield.guard.core import SILENCE
from lfield.mission.bindings import (
    LONGEST_LEASE,
    LONGEST_RESERVATION,
    LONGEST_RESERVED_WAIT,
    MAX_HEAP,
    MIN_HEAP,
    MOST_MEMBERS,
    SHORTEST_LEASE,
    SHORTEST_RESERVATION,
    USUAL_LEASE,
    USUAL_RESERVATION,
    USUAL_RESERVED_WAIT,
    Bindings,
    Needed,
    Recovery,
    ReservationTimes,
    each_needed,
    maker_of,
    on_fakes,
    undoubled,
)
from lfield.text.source import Diagnostics
from lfield.text.suggest import did_you_mean
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Entry, Listing, Node, Scalar, describe, read
from lfield.vm.contract import MAX_TIDY, Limits

_UNITS = {"B": 1, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
_SIZE = re.compile(r"([0-9]{1,12})\s*(B|KiB|MiB|GiB)")


def read_bindings(
    path: Path | None,
    needed: Needed,
    drivers: Drivers,
    *,
    simulate: bool = False,
    resources: dict[str, str] | None = None,
    hosts: Collection[str] | None = None,
    doubled: Collection[str] = (),
) -> Bindings:
    """The bindings in a file (None: there is no file), checked against what the mission needs.

    With `simulate`, needed devices that are not bound get what is usual for their agent's resource type (of
    `resources`), and every endpoint is SIMULATED. `hosts` are those of the team, None where it is not known.
    Of `doubled` agents only the limits are read. Raises BindingError with all problems, InputFileError when
    the file cannot be read.
    """
    found = Diagnostics()
    node = read(str(path), found) if path is not None else None
    bindings = Bindings()
    if path is not None and node is not None:
        reader = BindingsReader(
            needed, drivers, found, path.parent, simulate=simulate, hosts=hosts, doubled=doubled
        )
        bindings = reader.bindings(node)
    needed = undoubled(needed, doubled)
    problems = [diagnostic.render() for diagnostic in found.errors]
    problems += _without_driver(needed, drivers)
    # What is written wrong is not missing: the file's own errors are told first, and alone.
    if not simulate and not found.errors:
        problems += _unbound(bindings, needed, drivers, path)
    if problems:
        raise BindingError(problems, found.errors)
    return on_fakes(bindings, needed, drivers, resources) if simulate else bindings


def _without_driver(needed: Needed, drivers: Drivers) -> list[str]:
    known = sorted(name for driver in drivers.by_driver.values() for name in driver.manifests)
    return [
        f"{agent}.{name}: no installed driver makes a {device_type} "
        f"(device types installed: {', '.join(known) or 'none'})"
        for agent, name, device_type in each_needed(needed)
        if maker_of(drivers, device_type) is None
    ]


def _unbound(bindings: Bindings, needed: Needed, drivers: Drivers, path: Path | None) -> list[str]:
    where = f"in {path}" if path else "and there is no devices file"
    return [
        f"{agent}.{name} ({device_type}) is not bound {where}: add 'devices: {{{name}: {{driver: "
        f"{driver.name}, endpoint: ...}}}}' under the agent '{agent}', or use --sim"
        for agent, name, device_type in each_needed(needed)
        if name not in bindings.devices.get(agent, {}) and (driver := maker_of(drivers, device_type))
    ]


class BindingsReader:
    """One pass over a devices file; findings go to `found`."""

    def __init__(
        self,
        needed: Needed,
        drivers: Drivers,
        found: Diagnostics,
        folder: Path,
        *,
        simulate: bool,
        hosts: Collection[str] | None = None,
        doubled: Collection[str] = (),
    ) -> None:
        self._doubled = doubled
        self._needed, self._drivers, self._found = needed, drivers, found
        self._folder, self._simulate, self._hosts = folder, simulate, hosts

    def bindings(self, node: Node) -> Bindings:
        """The whole file; findings go to the diagnostics."""
        top = Fields(node, self._found, "a devices file")
        section = top.section("defaults")
        defaults = self._limits(section, Limits())
        section.done()
        unreachable_after = top.number("unreachable_after", 10.0, minimum=0.1, maximum=86400.0)
        silence = top.number("silence", SILENCE, minimum=0.1, maximum=10.0)
        recovery = self._recovery(top.section("recovery"), silence)
        reservations = _reservations(top.section("reservations"))
        waits: dict[str, float] = {}
        agents: dict[str, Limits] = {}
        devices: dict[str, dict[str, DeviceBinding]] = {}
        for entry, fields in top.section("agents").entries():
            if entry.key not in self._needed:
                hint = f"its agents: {', '.join(sorted(self._needed)) or 'none'}"
                fields.report("Y113", f"the deployment has no agent '{entry.key}'", entry.key_span, hint)
                continue
            agents[entry.key] = self._limits(fields, defaults)
            if "reserved_wait" in fields:
                waits[entry.key] = _reserved_wait(fields, "reserved_wait", reservations.wait)
            if entry.key in self._doubled:
                fields.node("devices")
            else:
                devices[entry.key] = dict(self._devices(entry.key, fields))
            fields.done()
        top.done()
        return Bindings(
            agents,
            devices,
            defaults,
            unreachable_after,
            silence,
            recovery,
            replace(reservations, waits=waits),
        )

    def _recovery(self, fields: Fields, silence: float) -> Recovery:
        lease = fields.number("lease", USUAL_LEASE, minimum=SHORTEST_LEASE, maximum=LONGEST_LEASE)
        if "lease" in fields and silence > lease:
            said = f"'lease' must be no shorter than 'silence', which is {silence:g}, not {lease:g}"
            hint = "the devices of a host that stands still would go on beside its successor"
            fields.report("Y113", said, fields.value_span("lease"), hint)
        members = fields.texts("members")
        written = fields.node("members")
        if isinstance(written, Listing) or _is_empty(written):
            self._check_members(fields, written.items if isinstance(written, Listing) else ())
        fields.done()
        return Recovery(lease, members)

    def _check_members(self, fields: Fields, nodes: Sequence[Node]) -> None:
        """Each is another host of the team, and they are not too many."""
        texts = [n for n in nodes if isinstance(n, Scalar) and isinstance(n.value, str)]
        members = [str(node.value) for node in texts]
        for number, (host, node) in enumerate(zip(members, texts, strict=True)):
            if host in members[:number]:
                fields.report("Y113", f"'{host}' is named twice", node.span, "each member counts once")
            elif self._hosts is not None and host not in self._hosts:
                hint = did_you_mean(host, self._hosts) or f"its hosts: {', '.join(self._hosts)}"
                fields.report("Y113", f"the deployment has no host '{host}'", node.span, hint)
        if not 1 <= len(nodes) <= MOST_MEMBERS:
            said = f"'members' must be 1 to {MOST_MEMBERS} hosts, not {len(nodes)}"
            hint = "more than half of them decide that a coordinator is lost"
            fields.report("Y113", said, fields.key_span("members"), hint)

    def _limits(self, fields: Fields, defaults: Limits) -> Limits:
        return Limits(
            heap=self._size(fields, "heap", defaults.heap),
            call_depth=fields.integer("call_depth", defaults.call_depth, minimum=1, maximum=1 << 20),
            array_length=fields.integer("array_length", defaults.array_length, minimum=1, maximum=1 << 29),
            string_length=fields.integer("string_length", defaults.string_length, minimum=1, maximum=1 << 31),
            threads=fields.integer("threads", defaults.threads, minimum=1, maximum=1 << 16),
            tidy=fields.number("tidy", defaults.tidy, minimum=0.0, maximum=MAX_TIDY),
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
        driver = self._drivers.by_driver.get(name)
        if driver is None:
            if name:
                hint = f"installed: {', '.join(sorted(self._drivers.by_driver)) or 'none'}"
                fields.report("Y113", f"there is no driver '{name}'", fields.value_span("driver"), hint)
            return None
        manifest = driver.manifests.get(needed[entry.key])
        if manifest is None:
            makes = " or ".join(sorted(driver.manifests))
            message = f"driver '{name}' makes a {makes}, and {entry.key} is a {needed[entry.key]}"
            fields.report("Y113", message, fields.value_span("driver"))
            return None
        fields.text("type", choices=(manifest.device.type,))
        binding = DeviceBinding(
            agent=agent,
            field=entry.key,
            type=manifest.device.type,
            driver=name,
            endpoint=fields.text("endpoint", required=not self._simulate),
            ttl=fields.number("ttl", 0.5, minimum=0.02, maximum=60.0),
            rest_within=fields.number("rest_within", 120.0, minimum=1.0, maximum=3600.0),
            safe_state=_safe_state(fields, manifest),
            without_policy=_without_policy(fields, manifest),
            limits=self._device_limits(fields, manifest),
            options=self._options(fields, manifest),
            waivers=self._waivers(fields, manifest),
            sim=list(fields.texts("sim")),
        )
        fields.done()
        return binding

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


def _reservations(fields: Fields) -> ReservationTimes:
    lease = fields.number(
        "lease", USUAL_RESERVATION, minimum=SHORTEST_RESERVATION, maximum=LONGEST_RESERVATION
    )
    wait = _reserved_wait(fields, "wait", USUAL_RESERVED_WAIT)
    fields.done()
    return ReservationTimes(lease, wait)


def _reserved_wait(fields: Fields, key: str, usual: float) -> float:
    return fields.number(key, usual, minimum=0.0, maximum=LONGEST_RESERVED_WAIT)


def _is_empty(node: Node | None) -> bool:
    """Whether there is a key with nothing behind it."""
    return isinstance(node, Scalar) and node.value is None


def _without_policy(fields: Fields, manifest: Manifest) -> WithoutPolicy | None:
    """None where the key is absent; both of its keys must be given."""
    if "without_policy" not in fields:
        return None
    states = manifest.device.safe_states
    if not states:
        message = f"a {manifest.device.type} only senses: nobody has to bring it into a safe state"
        fields.report("Y113", message, fields.value_span("without_policy"), "leave the key out")
        fields.node("without_policy")
        return None
    section = fields.section("without_policy")
    after = section.number("after", 30.0, required=True, minimum=LEAST_AFTER, maximum=86400.0)
    do = section.text("do", required=True, choices=states)
    section.done()
    return WithoutPolicy(after, do)


def _safe_state(fields: Fields, manifest: Manifest) -> str:
    """One of those of the manifest; '' for a pure sensor, which has none."""
    states = manifest.device.safe_states
    if states:
        return fields.text("safe_state", states[0], choices=states)
    if "safe_state" in fields:
        message = f"a {manifest.device.type} only senses: it has no safe state"
        fields.report("Y113", message, fields.value_span("safe_state"), "leave the key out")
        fields.text("safe_state")
    return ""
