"""Bindings as plain data: limits of agents, and the drivers and endpoints of their devices.

`bindings_file` reads them. No device is commanded by default: a needed device that is not bound is an error,
unless the mission is simulated; then it gets a simulated device.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping

import msgspec
from msgspec import Struct, field
from msgspec.structs import replace

from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.driver.driver_index import DriverInfo, DriverLookup
from lfield.driver.frame import Origin, Placement, Pose, Vector
from lfield.errors import BindingError
from lfield.guard.core import HOST_TIMEOUT
from lfield.text.suggestions import listed
from lfield.vm.engine_interface import AgentLimits

#: Bytes. A heap is addressed by 32-bit offsets; an empty agent needs a page.
MIN_HEAP, MAX_HEAP = 1 << 12, 1 << 31

#: Seconds that a host with simulated devices may be silent: no person or device is at risk, and a desktop
#: computer may be busy. The value in a devices file is for the field.
SIM_SILENCE = 2.0

#: Range and default of the lease of a fenced coordinator's host, in seconds.
MIN_LEASE, MAX_LEASE, DEFAULT_LEASE = 0.2, 60.0, 2.0

#: Range and default of the lease of a reservation, and range and default of the time that others wait for a
#: reserved resource, in seconds.
MIN_RESERVATION, MAX_RESERVATION, DEFAULT_RESERVATION = 0.5, 600.0, 6.0
MAX_RESERVED_WAIT, DEFAULT_RESERVED_WAIT = 3600.0, 5.0

#: Maximum number of hosts that decide on a loss: each of them talks to all others.
MAX_MEMBERS = 9

#: A value of an attribute that a binding states.
StatedValue = float | int | bool | str | tuple[str, ...]

#: Metres: maximum distance from the team's origin, and range of the altitude of an origin or position.
MAX_DISTANCE, MAX_ALTITUDE, MIN_ALTITUDE = 1e6, 1e5, -1e4

#: Agent id -> field name -> device type: the needs of a mission. Every agent is a key, also without devices.
NeededDevices = Mapping[str, Mapping[str, str]]


class RecoverySettings(Struct, frozen=True):
    """The hosts that decide that a coordinator is lost (appendix I), and the lease in seconds.

    A majority of the `members` decides. No members in a devices file means all hosts.
    """

    lease: float = DEFAULT_LEASE
    members: tuple[str, ...] = ()

    def among(self, hosts: Collection[str]) -> RecoverySettings:
        """The settings with the members in the order of the team. Raises BindingError for a large team
        without members.
        """
        if not self.members and len(hosts) > MAX_MEMBERS:
            raise BindingError(
                [
                    f"a team of {len(hosts)} hosts with a coordinator that calls heartbeatInterval needs the "
                    f"names of at most {MAX_MEMBERS} that decide: add 'recovery: {{members: [...]}}' to the "
                    "devices file"
                ]
            )
        return replace(self, members=tuple(h for h in hosts if not self.members or h in self.members))

    def __str__(self) -> str:
        return f"a lease of {self.lease:g} s among {listed(self.members)}"


class ReservationTimes(Struct, frozen=True):
    """Times of `reserve` in seconds: lease of a reservation without a heartbeat of its holder, and the time
    that others wait for a reserved resource; `waits` are those of single resources."""

    lease: float = DEFAULT_RESERVATION
    wait: float = DEFAULT_RESERVED_WAIT
    waits: Mapping[str, float] = field(default_factory=dict)


class MissionStart(Struct, frozen=True):
    """Hosts (`without`) that a restarted coordinator does not wait for."""

    without: tuple[str, ...] = ()


class Frames(Struct, frozen=True):
    """The team's frame: its `origin` on the Earth, and the poses of hosts and agents in it.

    The pose of an agent takes precedence over that of its host. `everybody` are all agents in the order of
    the deployment.
    """

    origin: Origin | None = None
    hosts: Mapping[str, Pose] = field(default_factory=dict)
    agents: Mapping[str, Pose] = field(default_factory=dict)
    everybody: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """Whether the team has a frame."""
        return self.origin is not None or bool(self.hosts or self.agents)

    def place(self, host: str) -> Vector | None:
        """The position of a host, None if it is not given."""
        pose = self.hosts.get(host)
        return None if pose is None else (pose.north, pose.east, pose.down)

    def placement(self, agent: str) -> Placement | None:
        """The placement of an agent; None if it is not given."""
        pose = self.agents.get(agent)
        if self.origin is None and pose is None:
            return None
        return Placement(self.origin, pose, self.everybody.index(agent) if agent in self.everybody else 0)


class Bindings(Struct, frozen=True):
    """Limits of agents, and devices by agent and field; times are in seconds.

    `attributes` are the stated values of single agents in units of the registry, a set as its members.
    `engine` selects the engine that runs the program (`lfield.vm.wasm.engine_selection`).
    """

    agents: Mapping[str, AgentLimits] = field(default_factory=dict)
    devices: Mapping[str, Mapping[str, DeviceBinding]] = field(default_factory=dict)
    defaults: AgentLimits = field(default_factory=AgentLimits)
    unreachable_after: float = 10.0
    silence: float = HOST_TIMEOUT
    recovery: RecoverySettings = field(default_factory=RecoverySettings)
    attributes: Mapping[str, Mapping[str, StatedValue]] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)
    reservations: ReservationTimes = field(default_factory=ReservationTimes)
    engine: str = "auto"
    start: MissionStart = field(default_factory=MissionStart)

    def reserved_wait(self, agent: str) -> float:
        """Seconds for which others wait for a reserved resource."""
        return self.reservations.waits.get(agent, self.reservations.wait)

    def limits(self, agent: str) -> AgentLimits:
        """The limits of an agent: its own, then the defaults of the file, then those of the machine."""
        return self.agents.get(agent, self.defaults)

    def of(self, agents: Collection[str]) -> list[DeviceBinding]:
        """Every device of these agents, for the guards of their host."""
        return [device for agent in agents for device in self.devices.get(agent, {}).values()]

    @property
    def all(self) -> list[DeviceBinding]:
        """Every device of the mission."""
        return self.of(list(self.devices))

    def check_lease_bounds(self) -> None:
        """Raise BindingError when the devices of a failed host may move for longer than its lease.

        Its guards stop them after `silence` seconds; after the lease another host may take over.
        """
        silence, lease = self.silence, self.recovery.lease
        if silence <= lease or all(device.is_sensor for device in self.all):
            return
        raise BindingError(
            [
                f"devices go safe after their host was silent for {silence:g} s, but its lease ends after "
                f"{lease:g} s, when another host may take over: write 'silence: {lease:g}' or less in the "
                f"devices file, or 'recovery: {{lease: {silence:g}}}' or more"
            ]
        )


def needed_devices_of(needed: NeededDevices) -> Iterator[tuple[str, str, str]]:
    """Agent, field and device type of every needed device."""
    for agent, fields in needed.items():
        for name, device_type in fields.items():
            yield agent, name, device_type


def without_doubles(needed: NeededDevices, doubled: Collection[str]) -> NeededDevices:
    """The needs without those of agents that a test replaces, which have no devices."""
    return {agent: {} if agent in doubled else fields for agent, fields in needed.items()}


def driver_of(drivers: DriverLookup, device_type: str) -> DriverInfo | None:
    """The driver that provides a device type."""
    return next((driver for driver in drivers.by_driver.values() if device_type in driver.manifests), None)


def on_fakes(
    bindings: Bindings,
    needed: NeededDevices,
    drivers: DriverLookup,
    resources: Mapping[str, str] | None = None,
) -> Bindings:
    """Every needed device simulated, with the limits and options of the file where it has them; the silence
    is SIM_SILENCE, or the lease where that is shorter.

    Every needed device type has a driver. `resources` are the types of the agents, from which a driver
    derives the kind of simulated device. Raises BindingError for devices that must be bound even then.
    """
    lacking = _without_fake(bindings, needed, drivers, resources or {})
    lacking += unplaced_devices(bindings, needed, drivers)
    if lacking:
        raise BindingError(lacking)
    simulated: dict[str, dict[str, DeviceBinding]] = {agent: {} for agent in needed}
    for agent, name, device_type in needed_devices_of(needed):
        bound = bindings.devices.get(agent, {}).get(name)
        simulated[agent][name] = (
            _faked(bound) if bound else _fake(bindings, agent, name, device_type, drivers, resources or {})
        )
    return replace(bindings, devices=simulated, silence=min(SIM_SILENCE, bindings.recovery.lease))


def chosen_fakes(
    bindings: Bindings, needed: NeededDevices, drivers: DriverLookup, resources: Mapping[str, str]
) -> list[str]:
    """The default simulated devices that `on_fakes` has chosen for unbound devices, a line for each
    choice."""
    devices: dict[str, list[str]] = {}
    for agent, name, device_type in needed_devices_of(needed):
        driver, bound = driver_of(drivers, device_type), bindings.devices.get(agent, {}).get(name)
        if driver is not None and bound == _fake(bindings, agent, name, device_type, drivers, resources):
            label = driver.manifests[device_type].fake_label(resources.get(agent, ""), agent)
            devices.setdefault(label, []).append(f"{agent}.{name}")
    return [
        f"{', '.join(names)}: {label}; to change this, bind the device in a devices file"
        for label, names in devices.items()
        if label
    ]


def _faked(device: DeviceBinding) -> DeviceBinding:
    """A bound device, simulated; devices of one endpoint share one simulator."""
    if device.endpoint.startswith(SIMULATED):
        return device
    return msgspec.structs.replace(device, endpoint=f"{SIMULATED}{device.endpoint or device.name}")


def _without_fake(
    bindings: Bindings, needed: NeededDevices, drivers: DriverLookup, resources: Mapping[str, str]
) -> list[str]:
    """The devices that cannot be simulated without a binding, a sentence each."""
    problems = []
    for agent, name, device_type in needed_devices_of(needed):
        driver = driver_of(drivers, device_type)
        if driver is None or name in bindings.devices.get(agent, {}):
            continue
        manifest = driver.manifests[device_type]
        known = manifest.fake_options(resources.get(agent, ""), agent)
        missing = [option.name for option in manifest.options if option.name not in known]
        if missing:
            problems.append(
                f"{agent}.{name} ({device_type}) needs {', '.join(missing)} also when simulated: bind it in "
                "a devices file"
            )
    return problems


def unplaced_devices(bindings: Bindings, needed: NeededDevices, drivers: DriverLookup) -> list[str]:
    """The devices with positions whose position in the team's frame is unknown; a sentence each.

    Their positions would be relative to their own origin, and compared with those of others.
    """
    problems = []
    for agent, name, device_type in needed_devices_of(needed) if bindings.frames else ():
        driver, placed = driver_of(drivers, device_type), bindings.frames.placement(agent)
        manifest = None if driver is None else driver.manifests[device_type]
        if manifest is None or not manifest.has_places or (placed is not None and placed.pose is not None):
            continue
        if placed is None or not manifest.geographic:
            lacks = "" if placed is None else ", since it has no global position"
            origin = ", or give the team an origin" if manifest.geographic else ""
            problems.append(
                f"{agent}.{name} ({device_type}) reports positions, but their place in the team's "
                f"frame is unknown{lacks}: give {agent} or its host a 'frame' in the devices file{origin}"
            )
    return problems


def _fake(
    bindings: Bindings,
    agent: str,
    name: str,
    device_type: str,
    drivers: DriverLookup,
    resources: Mapping[str, str],
) -> DeviceBinding:
    """A simulated device for a device that is not bound."""
    driver = driver_of(drivers, device_type)
    assert driver is not None, "types without a driver are reported before"
    manifest = driver.manifests[device_type]
    return DeviceBinding(
        agent=agent,
        field=name,
        type=device_type,
        driver=driver.name,
        endpoint=f"{SIMULATED}{agent}.{name}",
        safe_state=manifest.default_safe_state,
        options=manifest.fake_options(resources.get(agent, ""), agent),
        waivers=[waiver for waiver, _ in manifest.waivers],
        frame=bindings.frames.placement(agent),
    )


def with_files(
    bindings: Bindings,
    drivers: DriverLookup,
    place: Callable[[str], str],
    only: Collection[str] | None = None,
) -> Bindings:
    """The same with every file of an option replaced by `place`; `only` names devices, None for all."""

    def moved(device: DeviceBinding) -> DeviceBinding:
        options = drivers.by_driver[device.driver].manifests[device.type].options
        files = {
            o.name: place(str(device.options[o.name]))
            for o in options
            if o.type == "path" and device.options.get(o.name) and (only is None or device.name in only)
        }
        return msgspec.structs.replace(device, options={**device.options, **files}) if files else device

    return replace(
        bindings,
        devices={
            agent: {name: moved(device) for name, device in fields.items()}
            for agent, fields in bindings.devices.items()
        },
    )
