"""What agents may use and what their devices are bound to: plain data.

A devices file is read by `bindings_file`. Nothing is commanded from a default: a needed device that is not
bound is an error, unless the mission is simulated; then it gets a fake.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace

import msgspec

from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.driver.frame import Origin, Placement, Pose, Vector
from lfield.driver.known import Drivers, KnownDriver
from lfield.errors import BindingError
from lfield.guard.core import SILENCE
from lfield.text.suggest import listed
from lfield.vm.contract import Limits

#: A heap is addressed by 32-bit offsets; below a page not even an empty agent fits.
MIN_HEAP, MAX_HEAP = 1 << 12, 1 << 31

#: How long a host with fakes may be silent, in seconds: nothing can be hurt, and a desk is busy. What a
#: devices file says is for the field.
SIM_SILENCE = 2.0

#: How long a lease of a fenced coordinator's host may last, in seconds, and what it is unless it is chosen.
SHORTEST_LEASE, LONGEST_LEASE, USUAL_LEASE = 0.2, 60.0, 2.0

#: How long a reservation may last unheard, and what it is unless it is chosen; for how long others wait for
#: what is reserved, at most and unless it is chosen. In seconds.
SHORTEST_RESERVATION, LONGEST_RESERVATION, USUAL_RESERVATION = 0.5, 600.0, 6.0
LONGEST_RESERVED_WAIT, USUAL_RESERVED_WAIT = 3600.0, 5.0

#: More hosts than these do not decide that another one is lost: each of them talks to all others.
MOST_MEMBERS = 9

#: What a binding states of an attribute.
Stated = float | int | bool | str | tuple[str, ...]

#: Metres: how far from the team's origin anybody may be, and how high or low an origin or a place.
FARTHEST, HIGHEST, LOWEST = 1e6, 1e5, -1e4

#: Agent id -> field name -> device type: what a mission needs. Every agent is a key, also without devices.
Needed = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class Recovery:
    """Who decides that a coordinator is lost (appendix I), and how long a host may run one unheard (s).

    `members` are hosts; more than half of them decide. In a devices file none means all.
    """

    lease: float = USUAL_LEASE
    members: tuple[str, ...] = ()

    def among(self, hosts: Collection[str]) -> Recovery:
        """The same with its members in the order of the team. Raises BindingError when nobody has chosen them
        among too many."""
        if not self.members and len(hosts) > MOST_MEMBERS:
            raise BindingError(
                [
                    f"a team of {len(hosts)} hosts with a coordinator that calls heartbeatInterval needs the "
                    f"names of at most {MOST_MEMBERS} that decide: add 'recovery: {{members: [...]}}' to the "
                    "devices file"
                ]
            )
        return replace(self, members=tuple(h for h in hosts if not self.members or h in self.members))

    def __str__(self) -> str:
        return f"a lease of {self.lease:g} s among {listed(self.members)}"


@dataclass(frozen=True, slots=True)
class ReservationTimes:
    """Of `reserve`, in seconds: how long a reservation lasts when nothing is heard of its holder, and for how
    long others wait for what is reserved; `waits` are those of single resources."""

    lease: float = USUAL_RESERVATION
    wait: float = USUAL_RESERVED_WAIT
    waits: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class MissionStart:
    """What a new start of a coordinator does not wait for: the hosts in `without`."""

    without: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Frames:
    """The team's frame: its `origin` on the Earth, and the poses in it of hosts and of agents.

    An agent has its own, else its host's. `everybody` are all agents in the order of the deployment.
    """

    origin: Origin | None = None
    hosts: Mapping[str, Pose] = field(default_factory=dict)
    agents: Mapping[str, Pose] = field(default_factory=dict)
    everybody: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """Whether the team has a frame at all."""
        return self.origin is not None or bool(self.hosts or self.agents)

    def place(self, host: str) -> Vector | None:
        """Where a host is, None where nobody has said."""
        pose = self.hosts.get(host)
        return None if pose is None else (pose.north, pose.east, pose.down)

    def of(self, agent: str) -> Placement | None:
        """What is said of where an agent is; None for nothing."""
        pose = self.agents.get(agent)
        if self.origin is None and pose is None:
            return None
        return Placement(self.origin, pose, self.everybody.index(agent) if agent in self.everybody else 0)


@dataclass(frozen=True, slots=True)
class Bindings:
    """Limits of agents, and devices by agent and field; times are in seconds.

    `attributes` is what they state of single agents in the words of the registry, a set as its members.
    `engine` says what runs the program (`lfield.vm.wasm.choice`).
    """

    agents: Mapping[str, Limits] = field(default_factory=dict)
    devices: Mapping[str, Mapping[str, DeviceBinding]] = field(default_factory=dict)
    defaults: Limits = field(default_factory=Limits)
    unreachable_after: float = 10.0
    silence: float = SILENCE
    recovery: Recovery = field(default_factory=Recovery)
    attributes: Mapping[str, Mapping[str, Stated]] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)
    reservations: ReservationTimes = field(default_factory=ReservationTimes)
    engine: str = "auto"
    start: MissionStart = field(default_factory=MissionStart)

    def reserved_wait(self, agent: str) -> float:
        """For how many seconds others wait for a resource that somebody has reserved."""
        return self.reservations.waits.get(agent, self.reservations.wait)

    def limits(self, agent: str) -> Limits:
        """The limits of an agent: its own, then the defaults of the file, then the machine's."""
        return self.agents.get(agent, self.defaults)

    def of(self, agents: Collection[str]) -> list[DeviceBinding]:
        """Every device of these agents, as the guards of their host need them."""
        return [device for agent in agents for device in self.devices.get(agent, {}).values()]

    @property
    def all(self) -> list[DeviceBinding]:
        """Every device of the mission."""
        return self.of(list(self.devices))

    def see_that_nothing_outlives_a_lease(self) -> None:
        """Raise BindingError when the devices of a host that stands still go on for longer than its lease.

        Its guards stop them after the silence of the host; at the end of the lease another host may go on.
        """
        silence, lease = self.silence, self.recovery.lease
        if silence <= lease or all(device.is_sensor for device in self.all):
            return
        raise BindingError(
            [
                f"devices go safe when their host was silent for {silence:g} s, and its lease ends after "
                f"{lease:g} s, when another host may go on: write 'silence: {lease:g}' or less in the "
                f"devices file, or 'recovery: {{lease: {silence:g}}}' or more"
            ]
        )


def each_needed(needed: Needed) -> Iterator[tuple[str, str, str]]:
    """Agent, field and device type of every needed device."""
    for agent, fields in needed.items():
        for name, device_type in fields.items():
            yield agent, name, device_type


def undoubled(needed: Needed, doubled: Collection[str]) -> Needed:
    """What is needed when a test stands in for some agents, which then have no devices."""
    return {agent: {} if agent in doubled else fields for agent, fields in needed.items()}


def maker_of(drivers: Drivers, device_type: str) -> KnownDriver | None:
    """The driver that makes a device type."""
    return next((driver for driver in drivers.by_driver.values() if device_type in driver.manifests), None)


def on_fakes(
    bindings: Bindings, needed: Needed, drivers: Drivers, resources: Mapping[str, str] | None = None
) -> Bindings:
    """Every needed device on a fake, with the limits and options of the file where it has them; SIM_SILENCE,
    or the lease where that is shorter.

    Every needed device type has a driver. `resources` are the types of the agents: by them a driver knows
    what kind of device a fake shall be. Raises BindingError for devices that must be bound even so.
    """
    lacking = _lacking(bindings, needed, drivers, resources or {})
    lacking += nowhere(bindings, needed, drivers)
    if lacking:
        raise BindingError(lacking)
    simulated: dict[str, dict[str, DeviceBinding]] = {agent: {} for agent in needed}
    for agent, name, device_type in each_needed(needed):
        bound = bindings.devices.get(agent, {}).get(name)
        simulated[agent][name] = (
            _faked(bound) if bound else _fake(bindings, agent, name, device_type, drivers, resources or {})
        )
    return replace(bindings, devices=simulated, silence=min(SIM_SILENCE, bindings.recovery.lease))


def chosen_fakes(
    bindings: Bindings, needed: Needed, drivers: Drivers, resources: Mapping[str, str]
) -> list[str]:
    """Which fakes `on_fakes` has chosen where nobody has bound the device, a line for each choice."""
    devices: dict[str, list[str]] = {}
    for agent, name, device_type in each_needed(needed):
        driver, bound = maker_of(drivers, device_type), bindings.devices.get(agent, {}).get(name)
        if driver is not None and bound == _fake(bindings, agent, name, device_type, drivers, resources):
            words = driver.manifests[device_type].fake_words(resources.get(agent, ""))
            devices.setdefault(words, []).append(f"{agent}.{name}")
    return [
        f"{', '.join(names)}: {words}; a devices file chooses another"
        for words, names in devices.items()
        if words
    ]


def _faked(device: DeviceBinding) -> DeviceBinding:
    """A bound device on its fake; devices of one endpoint share one."""
    if device.endpoint.startswith(SIMULATED):
        return device
    return msgspec.structs.replace(device, endpoint=f"{SIMULATED}{device.endpoint or device.name}")


def _lacking(bindings: Bindings, needed: Needed, drivers: Drivers, resources: Mapping[str, str]) -> list[str]:
    """The devices of which no fake can be made without a binding, a sentence each."""
    problems = []
    for agent, name, device_type in each_needed(needed):
        driver = maker_of(drivers, device_type)
        if driver is None or name in bindings.devices.get(agent, {}):
            continue
        manifest = driver.manifests[device_type]
        known = manifest.fake_options(resources.get(agent, ""))
        missing = [option.name for option in manifest.options if option.name not in known]
        if missing:
            problems.append(
                f"{agent}.{name} ({device_type}) needs {', '.join(missing)} also on a fake: bind it in a "
                "devices file"
            )
    return problems


def nowhere(bindings: Bindings, needed: Needed, drivers: Drivers) -> list[str]:
    """The devices that have places, of which nobody could tell where in the team's frame; a sentence each.

    They would be about a place of their own, and be compared with the others'.
    """
    problems = []
    for agent, name, device_type in each_needed(needed) if bindings.frames else ():
        driver, placed = maker_of(drivers, device_type), bindings.frames.of(agent)
        manifest = None if driver is None else driver.manifests[device_type]
        if manifest is None or not manifest.has_places or (placed is not None and placed.pose is not None):
            continue
        if placed is None or not manifest.geographic:
            lacks = "" if placed is None else ", since it does not find itself on the Earth"
            origin = ", or the team an origin" if manifest.geographic else ""
            problems.append(
                f"{agent}.{name} ({device_type}) tells places, and nothing says where they are in the team's "
                f"frame{lacks}: give {agent} or its host a 'frame' in the devices file{origin}"
            )
    return problems


def _fake(
    bindings: Bindings,
    agent: str,
    name: str,
    device_type: str,
    drivers: Drivers,
    resources: Mapping[str, str],
) -> DeviceBinding:
    """A device that nobody has bound, on a fake of its own: there is nothing that could be hurt."""
    driver = maker_of(drivers, device_type)
    assert driver is not None, "a type without a driver has been told before"
    manifest = driver.manifests[device_type]
    return DeviceBinding(
        agent=agent,
        field=name,
        type=device_type,
        driver=driver.name,
        endpoint=f"{SIMULATED}{agent}.{name}",
        safe_state=manifest.default_safe_state,
        options=manifest.fake_options(resources.get(agent, "")),
        waivers=[waiver for waiver, _ in manifest.waivers],
        frame=bindings.frames.of(agent),
    )


def with_files(bindings: Bindings, drivers: Drivers, place: Callable[[str], str]) -> Bindings:
    """The same with every file that an option names at another place."""

    def moved(device: DeviceBinding) -> DeviceBinding:
        options = drivers.by_driver[device.driver].manifests[device.type].options
        files = {
            o.name: place(str(device.options[o.name]))
            for o in options
            if o.type == "path" and device.options.get(o.name)
        }
        return msgspec.structs.replace(device, options={**device.options, **files}) if files else device

    return replace(
        bindings,
        devices={
            agent: {name: moved(device) for name, device in fields.items()}
            for agent, fields in bindings.devices.items()
        },
    )
