"""A mission as plain data: all inputs of a host that runs it.

On the ground computer `load` builds the mission from files; a robot reads it from a bundle. Independent of L
and YAML.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from msgspec import structs

from lfield.bytecode.program import Program
from lfield.bytecode.side_effects import fenced_classes, reading_classes
from lfield.capability.model import Registry, Value
from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.driver.driver_index import DriverIndex, DriverLookup, installed_drivers
from lfield.mission.access.access_rules import NO_RULES, Access, CallPermissions
from lfield.mission.access.signed_bundle import FROM_FILES, BundleId
from lfield.mission.bindings import Bindings, Frames, NeededDevices, RecoverySettings, chosen_fakes, on_fakes
from lfield.mission.team import Team

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: The attributes that give an agent's position in the team's frame.
POSITION_ATTRIBUTES = frozenset({"north", "east", "down"})

#: The quantity of a vehicle that reports whether it is on the ground.
ON_GROUND = "landed"

#: Kind of a team's devices; '' for a team without devices.
DeviceWorld = Literal["", "fakes", "hardware"]


@dataclass(frozen=True)
class Mission:
    """Program, team, bindings, the `drivers` of its devices, and the access rules (`access`).

    The `registry` is None when the program names no capability; its live attributes are in their own units.
    `warnings` are rendered compiler warnings and the choice of simulated devices. `release` is the bundle
    that it was read from.
    """

    name: str
    program: Program
    team: Team
    bindings: Bindings
    drivers: DriverLookup
    registry: Registry | None = None
    warnings: tuple[str, ...] = ()
    access: Access = NO_RULES
    release: BundleId = FROM_FILES

    @cached_property
    def stated(self) -> Registry | None:
        """The registry with attributes from bindings; includes the poses of agents without position
        telemetry."""
        return (
            None
            if self.registry is None
            else with_poses(self.registry, self.team.types, self.bindings.frames)
        )

    @cached_property
    def max_block(self) -> int:
        """The maximum block size of a coordinator of the mission, in bytes."""
        return max((self.bindings.limits(m.id).heap for m in self.team.coordinators), default=1 << 20)

    @cached_property
    def has_live_values(self) -> bool:
        """Whether an agent reports attributes that change while the team works."""
        providers = self.registry.providers if self.registry is not None else {}
        return any(providers[name].live for name in sorted(set(self.team.types.values()) & providers.keys()))

    @property
    def needed(self) -> NeededDevices:
        """The device fields and their device types, by agent."""
        return needed_devices(self.program, self.team)

    @cached_property
    def calls(self) -> CallPermissions | None:
        """The access rules for portal calls; None if every coordinator may call every portal."""
        if not self.access.callers:
            return None
        return CallPermissions(self.access, self.team.members, [m.name for m in self.program.core.methods])

    def devices_of(self, host: str) -> list[DeviceBinding]:
        """The devices of the agents that are deployed on a host."""
        return self.bindings.of([member.id for member in self.team.members_on(self.team.number(host))])

    @cached_property
    def reading_hosts(self) -> Sequence[str]:
        """The hosts with resources that read the operator's input, in order."""
        classes, team = reading_classes(self.program), self.team
        found = {member.host for member in team.members if member.type in classes}
        return tuple(team.hosts[number] for number in sorted(found))

    @cached_property
    def hosts_with_vehicles(self) -> Sequence[str]:
        """The hosts with devices that report whether they are on the ground, in order."""
        agents = self.bindings.devices
        hosts = {
            self.team.homes[agent]
            for agent in agents
            if any(map(self._is_vehicle, self.bindings.of([agent])))
        }
        return tuple(sorted(hosts, key=self.team.number))

    def vehicles_of(self, host: str) -> list[str]:
        """The names of a host's devices that report whether they are on the ground."""
        return [device.name for device in self.devices_of(host) if self._is_vehicle(device)]

    def _is_vehicle(self, device: DeviceBinding) -> bool:
        driver = self.drivers.by_driver.get(device.driver)
        manifest = driver.manifests.get(device.type) if driver is not None else None
        return manifest is not None and any(each.name == ON_GROUND for each in manifest.device.telemetry)

    @cached_property
    def world(self) -> DeviceWorld:
        """The kind of the devices: `fakes`, `hardware`, '' without any."""
        endpoints = [device.endpoint for device in self.bindings.all]
        if not endpoints:
            return ""
        return "fakes" if all(endpoint.startswith(SIMULATED) for endpoint in endpoints) else "hardware"

    @cached_property
    def fenced(self) -> frozenset[str]:
        """The ids of coordinators with failover: they run only while their host holds a lease."""
        classes = fenced_classes(self.program)
        return frozenset(member.id for member in self.team.coordinators if member.type in classes)

    @cached_property
    def recovery(self) -> RecoverySettings:
        """The hosts that decide by majority that a fenced coordinator is lost, and the lease.

        Raises BindingError when they must be named and are not; `load` checks this.
        """
        chosen = self.bindings.recovery
        return chosen.among(self.team.hosts) if self.fenced else structs.replace(chosen, members=())

    def on_fakes(self) -> Mission:
        """The same mission with all devices simulated; its warnings list the selected devices."""
        needed, types = self.needed, self.team.types
        bindings = on_fakes(self.bindings, needed, self.drivers, types)
        chosen = chosen_fakes(bindings, needed, self.drivers, types)
        return replace(self, bindings=bindings, warnings=tuple(dict.fromkeys((*self.warnings, *chosen))))

    def at(self, team: Team) -> Mission:
        """The same mission with other addresses of its hosts."""
        return replace(self, team=team)

    def with_bindings(self, bindings: Bindings) -> Mission:
        return replace(self, bindings=bindings)


def with_poses(registry: Registry, types: Mapping[str, str], frames: Frames) -> Registry:
    """The registry with the positions of agents of these `types` from their poses.

    Position telemetry takes precedence over both; an attribute in the registry over the pose.
    """
    agents = dict(registry.agents)
    for agent, pose in frames.agents.items():
        provider = registry.providers.get(types.get(agent, ""))
        if provider is None or not POSITION_ATTRIBUTES.isdisjoint(provider.live):
            continue
        where: dict[str, Value] = {"north": pose.north, "east": pose.east, "down": pose.down}
        agents[agent] = {**where, **registry.agents.get(agent, {})}
    return structs.replace(registry, agents=agents)


def needed_devices(program: Program, team: Team) -> dict[str, dict[str, str]]:
    """The device fields and their device types of a team, by agent."""
    classes = {record.name: record for record in program.core.classes}
    return {m.id: {field.name: field.type for field in classes[m.type].devices} for m in team.members}


def drivers_for(drivers: DriverLookup, types: Collection[str]) -> DriverIndex:
    """The drivers for some device types."""
    limited = ((name, driver.for_types(types)) for name, driver in sorted(drivers.by_driver.items()))
    return DriverIndex({name: driver for name, driver in limited if driver.manifests})


def with_installed_drivers(
    mission: Mission, host: str, entries: Iterable[EntryPoint] | None = None
) -> Mission:
    """The mission with the installed drivers of the devices of its host.

    The drivers of other devices stay: they tell the host which hosts have vehicles. Raises PluginError
    for a driver of its own devices that is not installed.
    """
    own = {device.driver for device in mission.devices_of(host)}
    installed = installed_drivers(mission.drivers, own, entries).by_driver
    return replace(mission, drivers=DriverIndex({**mission.drivers.by_driver, **installed}))


def duplicate_statements(mission: Mission) -> list[str]:
    """Attributes that both the devices file and the mission's registry or frame state, a line each."""
    own, placed = mission.registry, mission.stated
    if own is None or placed is None:
        return []
    return [
        f"{name} of {agent} is stated in the devices file and {_where(own, agent, name)}, which counts"
        for agent, values in mission.bindings.attributes.items()
        for name in values
        if name in placed.agents.get(agent, {})
    ]


def _where(own: Registry, agent: str, name: str) -> str:
    """The other source of an attribute."""
    return "in the mission's registry" if name in own.agents.get(agent, {}) else "by its frame there"
