"""Reads `mission.devices.yaml`: limits of agents, and what their devices are bound to.

```yaml
agents:
  alpha:                                   # an agent of the deployment
    heap: 2 MiB                            # limits of this agent
    attributes: {payload: 1.2 kg}          # what is so of this robot, in the words of the registry
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
        waivers: [device_watchdog]         # protections that are knowingly given up; with a reason each,
                                           # where one is needed: {autonomous_motion: "why"}
        sim: ["battery=0.5"]               # of its fake, with --sim: see `lfield sim fault`
defaults: {heap: 1 MiB, call_depth: 500}   # limits of every agent
unreachable_after: 10                      # seconds until UnreachableResourceException
frame: {origin: {latitude: 47.3977, longitude: 8.5456, altitude: 488.0}}  # the team's place on the Earth
hosts: {hall: {frame: {north: 12.0, east: 4.0}}}   # where its agents are in the team's frame
silence: 0.2                               # seconds without the host before its devices go safe (fakes: 2)
engine: auto                               # what runs the program: auto, wasm or reference
recovery: {lease: 2, members: [a, b, c]}   # of coordinators that call heartbeatInterval: who
                                           # decides that one is lost, and the seconds it may run unheard
reservations: {lease: 6, wait: 5}          # seconds that a `reserve` lasts without a sign of its holder,
                                           # and that others wait for what is reserved
start: {without: [d]}                      # hosts that a new start of a coordinator does not wait for
```

The keys of a device that every driver has are `driver`, `endpoint`, `ttl`, `safe_state`, `rest_within`,
`without_policy`, `limits`, `waivers`, `sim` and, for those who read it, `type`; the rest are the driver's own
options. What fits no agent, device, driver or type is an error, all of them at once, each drawn at its place.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from lfield.capability.model import Attribute
from lfield.capability.reading.draft import Draft
from lfield.capability.reading.values import read_values
from lfield.driver.binding import DeviceBinding
from lfield.driver.frame import Pose
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
    Frames,
    MissionStart,
    Needed,
    Recovery,
    ReservationTimes,
    Stated,
    each_needed,
    maker_of,
    nowhere,
    on_fakes,
    undoubled,
)
from lfield.mission.reading.devices import DevicesReader
from lfield.mission.reading.frames import frames_of, read_hosts, read_origin, read_pose
from lfield.text.source import Diagnostics
from lfield.text.suggest import did_you_mean
from lfield.text.visible import clipped
from lfield.text.yaml_fields import Fields
from lfield.text.yaml_source import Entry, Listing, Node, Scalar, describe, read
from lfield.vm.contract import MAX_TIDY, Limits
from lfield.vm.wasm.choice import CHOICES

_UNITS = {"B": 1, "KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
_SIZE = re.compile(r"([0-9]{1,12})\s*(B|KiB|MiB|GiB)")

#: Of a large team not all are named, in characters.
_LONGEST_HINT = 400


def read_bindings(
    path: Path | None,
    needed: Needed,
    drivers: Drivers,
    *,
    simulate: bool = False,
    resources: dict[str, str] | None = None,
    hosts: Collection[str] | None = None,
    attributes: Callable[[], Mapping[str, Attribute]] | None = None,
    homes: Mapping[str, str] | None = None,
    doubled: Collection[str] = (),
) -> Bindings:
    """The bindings in a file (None: there is no file), checked against what the mission needs.

    With `simulate`, needed devices that are not bound get what is usual for their agent's resource type (of
    `resources`), and every endpoint is SIMULATED. `hosts` are those of the team, None where it is not known,
    `homes` those of its agents; `attributes` gives those of the registry, None where nobody asks for them. Of
    `doubled` agents only the limits and the pose are read, and what is stated. Raises BindingError with all
    problems, InputFileError when the file cannot be read.
    """
    found = Diagnostics()
    node = read(str(path), found) if path is not None else None
    bindings = Bindings()
    if path is not None and node is not None:
        reader = BindingsReader(
            needed,
            drivers,
            found,
            path.parent,
            simulate=simulate,
            hosts=hosts,
            homes=homes,
            doubled=doubled,
        )
        reader.attributes = attributes
        bindings = reader.bindings(node)
    needed = undoubled(needed, doubled)
    problems = [diagnostic.render() for diagnostic in found.errors]
    problems += _without_driver(needed, drivers)
    # What is written wrong is not missing: the file's own errors are told first, and alone.
    if not simulate and not found.errors:
        problems += _unbound(bindings, needed, drivers, path) or nowhere(bindings, needed, drivers)
    if problems:
        raise BindingError(problems, found.errors)
    return on_fakes(bindings, needed, drivers, resources) if simulate else bindings


def read_frames(path: Path | None, homes: Mapping[str, str]) -> Frames:
    """Only where a team is by a devices file (None: there is no file); `homes` are the hosts of its agents.

    Raises as `read_bindings`, for what is wrong of that.
    """
    found = Diagnostics()
    node = read(str(path), found) if path is not None else None
    frames = Frames()
    if node is not None:
        top = Fields(node, found, "a devices file")
        frames = _frames(top, list(top.section("agents").entries()), homes, None, tuple(homes))
    if found.errors:
        raise BindingError([diagnostic.render() for diagnostic in found.errors], found.errors)
    return frames


def _frames(
    top: Fields,
    agents: Sequence[tuple[Entry, Fields]],
    homes: Mapping[str, str],
    hosts: Collection[str] | None,
    everybody: tuple[str, ...],
) -> Frames:
    """Where the team, its hosts and its agents are."""
    origin, poses = read_origin(top), read_hosts(top, hosts)
    own: dict[str, Pose] = {}
    for entry, fields in agents:
        if (pose := read_pose(fields)) is not None:
            own[entry.key] = pose
    return frames_of(origin, poses, own, homes, everybody)


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
        homes: Mapping[str, str] | None = None,
        doubled: Collection[str] = (),
    ) -> None:
        self._needed, self._found, self._doubled = needed, found, doubled
        self._hosts, self._homes = hosts, homes or {}
        self._devices = DevicesReader(drivers, folder, simulate=simulate)
        #: The attributes of the registry, None where nobody asks for them.
        self.attributes: Callable[[], Mapping[str, Attribute]] | None = None

    def bindings(self, node: Node) -> Bindings:
        """The whole file; findings go to the diagnostics."""
        top = Fields(node, self._found, "a devices file")
        section = top.section("defaults")
        defaults = self._limits(section, Limits())
        section.done()
        unreachable_after = top.number("unreachable_after", 10.0, minimum=0.1, maximum=86400.0)
        engine = top.text("engine", "auto", choices=CHOICES)
        silence = top.number("silence", SILENCE, minimum=0.1, maximum=10.0)
        recovery = self._recovery(top.section("recovery"), silence)
        reservations = _reservations(top.section("reservations"))
        start = self._start(top.section("start"))
        waits: dict[str, float] = {}
        entries = list(top.section("agents").entries())
        # Before the devices, which have to know.
        frames = _frames(top, entries, self._homes, self._hosts, tuple(self._needed))
        agents: dict[str, Limits] = {}
        devices: dict[str, dict[str, DeviceBinding]] = {}
        stated: dict[str, dict[str, Stated]] = {}
        for entry, fields in entries:
            if entry.key not in self._needed:
                hint = f"its agents: {clipped(', '.join(sorted(self._needed)) or 'none', _LONGEST_HINT)}"
                fields.report("Y113", f"the deployment has no agent '{entry.key}'", entry.key_span, hint)
                continue
            agents[entry.key] = self._limits(fields, defaults)
            agent, placement = entry.key, frames.of(entry.key)
            if "reserved_wait" in fields:
                waits[agent] = _reserved_wait(fields, "reserved_wait", reservations.wait)
            if agent in self._doubled:
                fields.node("devices")
            else:
                devices[agent] = self._devices.devices(agent, fields, self._needed[agent], placement)
            if values := self._stated(fields):
                stated[agent] = values
            fields.done()
        top.done()
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

    def _stated(self, fields: Fields) -> dict[str, Stated]:
        """What is stated of an agent, in the units of the registry."""
        if self.attributes is None or "attributes" not in fields:
            fields.node("attributes")
            return {}
        draft = Draft((), self._found, attributes=dict(self.attributes()))
        values = read_values(draft, fields.section("attributes"))
        return {name: tuple(sorted(v)) if isinstance(v, frozenset) else v for name, v in values.items()}

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
        self._check_hosts(fields, nodes, "each member counts once")
        if not 1 <= len(nodes) <= MOST_MEMBERS:
            said = f"'members' must be 1 to {MOST_MEMBERS} hosts, not {len(nodes)}"
            hint = "more than half of them decide that a coordinator is lost"
            fields.report("Y113", said, fields.key_span("members"), hint)

    def _start(self, fields: Fields) -> MissionStart:
        without = fields.texts("without")
        written = fields.node("without")
        if isinstance(written, Listing):
            self._check_hosts(fields, written.items, "once is enough")
        fields.done()
        return MissionStart(without)

    def _check_hosts(self, fields: Fields, nodes: Sequence[Node], once: str) -> None:
        """Each is another host of the team; `once` is the hint about one that is named twice."""
        texts = [n for n in nodes if isinstance(n, Scalar) and isinstance(n.value, str)]
        names = [str(node.value) for node in texts]
        for number, (host, node) in enumerate(zip(names, texts, strict=True)):
            if host in names[:number]:
                fields.report("Y113", f"'{host}' is named twice", node.span, once)
            elif self._hosts is not None and host not in self._hosts:
                hint = did_you_mean(host, self._hosts) or f"its hosts: {', '.join(self._hosts)}"
                fields.report("Y113", f"the deployment has no host '{host}'", node.span, hint)

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
