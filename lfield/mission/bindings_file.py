"""Reads the devices file `mission.devices.yaml`: limits of agents, and the bindings of their devices.

```yaml
agents:
  alpha:                                   # an agent of the deployment
    heap: 2 MiB                            # limits of this agent
    attributes: {payload: 1.2 kg}          # attributes of this robot, as in the registry
    reserved_wait: 2                       # seconds for which others wait while it is reserved
    devices:
      fc:
        driver: mavlink
        endpoint: "udp:127.0.0.1:14550"
        system: 1                          # an option of this driver
        limits: {speed: 5.0}               # SI units; the driver's manifest lists them
        ttl: 0.5                           # seconds: lifetime of a setpoint, and latest start of a command
        safe_state: land
        rest_within: 120                   # seconds to come to rest when its host stops
        without_policy: {after: 30, do: land}    # after 30 s without a coordinator that used it
        waivers: [device_watchdog]         # protections that are given up deliberately; with a reason where
                                           # one is required: {autonomous_motion: "why"}
        sim: ["battery=0.5"]               # of its simulated device, with --sim: see `lfield sim fault`
defaults: {heap: 1 MiB, call_depth: 500}   # limits of every agent
unreachable_after: 10                      # seconds until UnreachableResourceException
frame: {origin: {latitude: 47.3977, longitude: 8.5456, altitude: 488.0}}  # origin of the team's frame
hosts: {hall: {frame: {north: 12.0, east: 4.0}}}   # pose of its agents in the team's frame
silence: 0.2                               # seconds until devices go safe without a heartbeat of the host
engine: auto                               # auto, wasm or reference
recovery: {lease: 2, members: [a, b, c]}   # of coordinators that call heartbeatInterval: the
                                           # hosts that decide that one is lost, and the lease in seconds
reservations: {lease: 6, wait: 5}          # seconds that a `reserve` lasts without a heartbeat of its
                                           # holder, and that others wait for a reserved resource
start: {without: [d]}                      # hosts that a restart of a coordinator does not wait for
```

The keys of a device that every driver has are `driver`, `endpoint`, `ttl`, `safe_state`, `rest_within`,
`without_policy`, `limits`, `waivers`, `sim` and, for other readers of the file, `type`; the rest are options
of the driver. Anything that matches no agent, device, driver or type is an error; all errors are reported at
once, each at its position.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

from msgspec.structs import replace

from lfield.capability.model import Attribute
from lfield.capability.registry_reader.attribute_values import read_values
from lfield.capability.registry_reader.registry_builder import RegistryBuilder
from lfield.driver.binding import DeviceBinding
from lfield.driver.driver_index import DriverLookup
from lfield.driver.frame import Pose
from lfield.errors import BindingError
from lfield.guard.core import HOST_TIMEOUT
from lfield.mission.bindings import (
    DEFAULT_LEASE,
    DEFAULT_RESERVATION,
    DEFAULT_RESERVED_WAIT,
    MAX_HEAP,
    MAX_LEASE,
    MAX_MEMBERS,
    MAX_RESERVATION,
    MAX_RESERVED_WAIT,
    MIN_HEAP,
    MIN_LEASE,
    MIN_RESERVATION,
    Bindings,
    Frames,
    MissionStart,
    NeededDevices,
    RecoverySettings,
    ReservationTimes,
    StatedValue,
    driver_of,
    needed_devices_of,
    on_fakes,
    unplaced_devices,
    without_doubles,
)
from lfield.mission.devices_reader.device_bindings import DeviceBindingsReader
from lfield.mission.devices_reader.frame_poses import frames_of, read_hosts, read_origin, read_pose
from lfield.text.source_text import Diagnostic, Diagnostics
from lfield.text.suggestions import did_you_mean
from lfield.text.terminal_escape import truncate
from lfield.text.yaml_fields import YamlFields
from lfield.text.yaml_source import YamlEntry, YamlList, YamlNode, YamlScalar, describe, read
from lfield.vm.engine_interface import MAX_TIDY_SECONDS, AgentLimits
from lfield.vm.wasm.engine_selection import CHOICES

_UNITS = {"B": 1, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
_SIZE = re.compile(r"([0-9]{1,12})\s*(B|KiB|MiB|GiB)")

#: The longest list of agents in a hint, in characters.
_LONGEST_HINT = 400


def read_bindings(
    path: Path | None,
    needed: NeededDevices,
    drivers: DriverLookup,
    *,
    simulate: bool = False,
    resources: Mapping[str, str] | None = None,
    hosts: Collection[str] | None = None,
    attributes: Callable[[], Mapping[str, Attribute]] | None = None,
    homes: Mapping[str, str] | None = None,
    doubled: Collection[str] = (),
) -> Bindings:
    """The bindings in a file (None: there is no file), checked against the needs of the mission.

    With `simulate`, needed devices that are not bound get the default for their agent's resource type (of
    `resources`), and every endpoint is SIMULATED. `hosts` are those of the team, None where it is unknown,
    `homes` the hosts of its agents; `attributes` returns those of the registry, None where they are not
    checked. Of `doubled` agents only limits, pose and attributes are read. Raises BindingError with all
    errors, InputFileError when the file cannot be read.
    """
    diagnostics = Diagnostics()
    node = read(str(path), diagnostics) if path is not None else None
    bindings = Bindings()
    if path is not None and node is not None:
        reader = BindingsReader(
            needed,
            DeviceBindingsReader(drivers, path.parent, simulate=simulate, resources=resources),
            diagnostics,
            hosts=hosts,
            homes=homes,
            doubled=doubled,
        )
        reader.attributes = attributes
        bindings = reader.bindings(node)
    needed = without_doubles(needed, doubled)
    problems = [diagnostic.render() for diagnostic in diagnostics.errors]
    problems += _without_driver(needed, drivers)
    # A misspelt binding is not a missing one: report errors of the file first, and alone.
    if not simulate and not diagnostics.errors:
        problems += _unbound(bindings, needed, drivers, path) or unplaced_devices(bindings, needed, drivers)
    if problems:
        raise BindingError(problems, diagnostics.errors)
    return on_fakes(bindings, needed, drivers, resources) if simulate else bindings


def unstated_options(
    path: Path, bindings: Bindings, drivers: DriverLookup, resources: Mapping[str, str]
) -> list[Diagnostic]:
    """Warnings about options that the names of the mission should determine, but a valid devices file does
    not.

    `bindings` are those of the file, `resources` the types of the agents.
    """
    diagnostics = Diagnostics()
    node = read(str(path), diagnostics)
    top = [] if node is None else YamlFields(node, diagnostics, "a devices file").section("agents").entries()
    for agent, fields in top:
        for device, stated in fields.section("devices").entries():
            if (binding := bindings.devices.get(agent.key, {}).get(device.key)) is None:
                continue
            manifest = drivers.by_driver[binding.driver].manifests[binding.type]
            for option in manifest.undecided_options(resources.get(agent.key, ""), agent.key):
                if option.name in stated:
                    continue
                values = dict.fromkeys(str(fake.get(option.name)) for fake in manifest.fakes.values())
                message = f"{option.name} not stated: simulated as a {option.default}"
                hint = f"write {option.name}: {' or '.join(values)}"
                diagnostics.add(Diagnostic("Y116", message, device.key_span, hint, "warning"))
    return diagnostics.in_order()


def read_frames(path: Path | None, homes: Mapping[str, str]) -> Frames:
    """The frames in a devices file (None: there is no file); `homes` are the hosts of its agents.

    Raises as `read_bindings`, for errors in those keys.
    """
    found = Diagnostics()
    node = read(str(path), found) if path is not None else None
    frames = Frames()
    if node is not None:
        top = YamlFields(node, found, "a devices file")
        frames = _frames(top, list(top.section("agents").entries()), homes, None, tuple(homes))
    if found.errors:
        raise BindingError([diagnostic.render() for diagnostic in found.errors], found.errors)
    return frames


def _frames(
    top: YamlFields,
    agents: Sequence[tuple[YamlEntry, YamlFields]],
    homes: Mapping[str, str],
    hosts: Collection[str] | None,
    everybody: tuple[str, ...],
) -> Frames:
    """The frame of the team, and the poses of its hosts and agents."""
    origin, poses = read_origin(top), read_hosts(top, hosts)
    own: dict[str, Pose] = {}
    for entry, fields in agents:
        if (pose := read_pose(fields)) is not None:
            own[entry.key] = pose
    return frames_of(origin, poses, own, homes, everybody)


def _without_driver(needed: NeededDevices, drivers: DriverLookup) -> list[str]:
    known = sorted(name for driver in drivers.by_driver.values() for name in driver.manifests)
    return [
        f"{agent}.{name}: no installed driver provides a {device_type} "
        f"(device types installed: {', '.join(known) or 'none'})"
        for agent, name, device_type in needed_devices_of(needed)
        if driver_of(drivers, device_type) is None
    ]


def _unbound(
    bindings: Bindings, needed: NeededDevices, drivers: DriverLookup, path: Path | None
) -> list[str]:
    where = f"in {path}" if path else "and there is no devices file"
    return [
        f"{agent}.{name} ({device_type}) is not bound {where}: add 'devices: {{{name}: {{driver: "
        f"{driver.name}, endpoint: ...}}}}' under the agent '{agent}', or simulate it with "
        "'lfield up --sim'"
        for agent, name, device_type in needed_devices_of(needed)
        if name not in bindings.devices.get(agent, {}) and (driver := driver_of(drivers, device_type))
    ]


class BindingsReader:
    """One pass over a devices file; findings go to `found`."""

    def __init__(
        self,
        needed: NeededDevices,
        devices: DeviceBindingsReader,
        found: Diagnostics,
        *,
        hosts: Collection[str] | None = None,
        homes: Mapping[str, str] | None = None,
        doubled: Collection[str] = (),
    ) -> None:
        self._needed, self._found, self._doubled = needed, found, doubled
        self._hosts, self._homes = hosts, homes or {}
        self._devices = devices
        #: The attributes of the registry, None where they are not checked.
        self.attributes: Callable[[], Mapping[str, Attribute]] | None = None

    def bindings(self, node: YamlNode) -> Bindings:
        """The bindings in the whole file."""
        top = YamlFields(node, self._found, "a devices file")
        section = top.section("defaults")
        defaults = self._limits(section, AgentLimits())
        section.report_unread()
        unreachable_after = top.number("unreachable_after", 10.0, minimum=0.1, maximum=86400.0)
        engine = top.text("engine", "auto", choices=CHOICES)
        silence = top.number("silence", HOST_TIMEOUT, minimum=0.1, maximum=10.0)
        recovery = self._recovery(top.section("recovery"), silence)
        reservations = _reservations(top.section("reservations"))
        start = self._start(top.section("start"))
        waits: dict[str, float] = {}
        entries = list(top.section("agents").entries())
        # Before the devices, whose positions depend on them.
        frames = _frames(top, entries, self._homes, self._hosts, tuple(self._needed))
        agents: dict[str, AgentLimits] = {}
        devices: dict[str, dict[str, DeviceBinding]] = {}
        stated: dict[str, dict[str, StatedValue]] = {}
        for entry, fields in entries:
            if entry.key not in self._needed:
                hint = f"its agents: {truncate(', '.join(sorted(self._needed)) or 'none', _LONGEST_HINT)}"
                fields.report("Y113", f"the deployment has no agent '{entry.key}'", entry.key_span, hint)
                continue
            agents[entry.key] = self._limits(fields, defaults)
            agent, placement = entry.key, frames.placement(entry.key)
            if "reserved_wait" in fields:
                waits[agent] = _reserved_wait(fields, "reserved_wait", reservations.wait)
            if agent in self._doubled:
                fields.node("devices")
            else:
                devices[agent] = self._devices.devices(agent, fields, self._needed[agent], placement)
            if values := self._stated(fields):
                stated[agent] = values
            fields.report_unread()
        top.report_unread()
        self._devices.report_conflicts()
        reservations = replace(reservations, waits=waits)
        return Bindings(
            agents,
            devices,
            defaults,
            unreachable_after,
            silence,
            recovery,
            stated,
            frames,
            reservations,
            engine,
            start,
        )

    def _stated(self, fields: YamlFields) -> dict[str, StatedValue]:
        """The attributes stated for an agent, in the units of the registry."""
        if self.attributes is None or "attributes" not in fields:
            fields.node("attributes")
            return {}
        builder = RegistryBuilder((), self._found, attributes=dict(self.attributes()))
        values = read_values(builder, fields.section("attributes"))
        return {name: tuple(sorted(v)) if isinstance(v, frozenset) else v for name, v in values.items()}

    def _recovery(self, fields: YamlFields, silence: float) -> RecoverySettings:
        lease = fields.number("lease", DEFAULT_LEASE, minimum=MIN_LEASE, maximum=MAX_LEASE)
        if "lease" in fields and silence > lease:
            message = f"'lease' must be no shorter than 'silence', which is {silence:g}, not {lease:g}"
            hint = "otherwise the devices of a failed host still move when its successor starts"
            fields.report("Y113", message, fields.value_span("lease"), hint)
        members = fields.texts("members")
        written = fields.node("members")
        if isinstance(written, YamlList) or _is_empty(written):
            self._check_members(fields, written.items if isinstance(written, YamlList) else ())
        fields.report_unread()
        return RecoverySettings(lease, members)

    def _check_members(self, fields: YamlFields, nodes: Sequence[YamlNode]) -> None:
        """Checks that each member is another host of the team, and that there are at most MAX_MEMBERS."""
        self._check_hosts(fields, nodes, "name each member once")
        if not 1 <= len(nodes) <= MAX_MEMBERS:
            message = f"'members' must be 1 to {MAX_MEMBERS} hosts, not {len(nodes)}"
            hint = "more than half of them decide that a coordinator is lost"
            fields.report("Y113", message, fields.key_span("members"), hint)

    def _start(self, fields: YamlFields) -> MissionStart:
        without = fields.texts("without")
        written = fields.node("without")
        if isinstance(written, YamlList):
            self._check_hosts(fields, written.items, "name it once")
        fields.report_unread()
        return MissionStart(without)

    def _check_hosts(self, fields: YamlFields, nodes: Sequence[YamlNode], once: str) -> None:
        """Checks that each is another host of the team; `once` is the hint for a duplicate."""
        texts = [n for n in nodes if isinstance(n, YamlScalar) and isinstance(n.value, str)]
        names = [str(node.value) for node in texts]
        for number, (host, node) in enumerate(zip(names, texts, strict=True)):
            if host in names[:number]:
                fields.report("Y113", f"'{host}' is named twice", node.span, once)
            elif self._hosts is not None and host not in self._hosts:
                hint = did_you_mean(host, self._hosts) or f"its hosts: {', '.join(self._hosts)}"
                fields.report("Y113", f"the deployment has no host '{host}'", node.span, hint)

    def _limits(self, fields: YamlFields, defaults: AgentLimits) -> AgentLimits:
        return AgentLimits(
            heap=self._size(fields, "heap", defaults.heap),
            call_depth=fields.integer("call_depth", defaults.call_depth, minimum=1, maximum=1 << 20),
            array_length=fields.integer("array_length", defaults.array_length, minimum=1, maximum=1 << 29),
            string_length=fields.integer("string_length", defaults.string_length, minimum=1, maximum=1 << 31),
            threads=fields.integer("threads", defaults.threads, minimum=1, maximum=1 << 16),
            tidy=fields.number("tidy", defaults.tidy, minimum=0.0, maximum=MAX_TIDY_SECONDS),
        )

    def _size(self, fields: YamlFields, key: str, default: int) -> int:
        node = fields.node(key)
        if node is None:
            return default
        text = node.value if isinstance(node, YamlScalar) and isinstance(node.value, str) else ""
        match = _SIZE.fullmatch(text)
        size = int(match[1]) * _UNITS[match[2]] if match else 0
        if not MIN_HEAP <= size <= MAX_HEAP:
            message = f"'{key}' must be a size from 4 KiB to 2 GiB, not {describe(node)}"
            fields.report("Y112", message, node.span, "write 512 KiB or 2 MiB")
            return default
        return size


def _reservations(fields: YamlFields) -> ReservationTimes:
    lease = fields.number("lease", DEFAULT_RESERVATION, minimum=MIN_RESERVATION, maximum=MAX_RESERVATION)
    wait = _reserved_wait(fields, "wait", DEFAULT_RESERVED_WAIT)
    fields.report_unread()
    return ReservationTimes(lease, wait)


def _reserved_wait(fields: YamlFields, key: str, usual: float) -> float:
    return fields.number(key, usual, minimum=0.0, maximum=MAX_RESERVED_WAIT)


def _is_empty(node: YamlNode | None) -> bool:
    """Whether a key has no value."""
    return isinstance(node, YamlScalar) and node.value is None
