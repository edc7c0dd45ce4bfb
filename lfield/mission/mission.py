"""A mission as plain data: all that a host runs from, however it came about.

On the desk `load` makes it of files; a robot reads it from a bundle. Nothing here knows L or YAML.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from lfield.bytecode.acting import fenced_classes
from lfield.bytecode.program import Program
from lfield.capability.model import Registry, Value
from lfield.driver.binding import SIMULATED, DeviceBinding
from lfield.driver.known import Drivers, KnownDrivers
from lfield.mission.access.release import FROM_FILES, Release
from lfield.mission.access.rules import UNWRITTEN, Access, Calls
from lfield.mission.bindings import Bindings, Frames, Needed, Recovery, chosen_fakes, on_fakes
from lfield.mission.team import Team

#: The attributes that say where an agent is in the team's frame.
PLACE = frozenset({"north", "east", "down"})

#: The quantity of a vehicle that says whether it stands on the ground.
ON_GROUND = "landed"

#: What the devices of a team are. A team that has none is neither.
World = Literal["", "fakes", "hardware"]


@dataclass(frozen=True, slots=True)
class Mission:
    """Program, team, bindings, the `drivers` of its devices, and who may do what: `access`.

    The `registry` is None when the program names no capability; its live attributes are in their own units.
    `warnings` are what the compiler had to say, drawn, and which fakes were chosen. `release` is the bundle
    that it was read from.
    """

    name: str
    program: Program
    team: Team
    bindings: Bindings
    drivers: Drivers
    registry: Registry | None = None
    warnings: tuple[str, ...] = ()
    access: Access = UNWRITTEN
    release: Release = FROM_FILES

    @property
    def stated(self) -> Registry | None:
        """The registry with what bindings state of agents: where those are whose devices do not tell it."""
        return None if self.registry is None else placed(self.registry, self.team.types, self.bindings.frames)

    @property
    def max_block(self) -> int:
        """The largest block a coordinator of the mission may have, in bytes."""
        return max((self.bindings.limits(m.id).heap for m in self.team.coordinators), default=1 << 20)

    @property
    def needed(self) -> Needed:
        """For each agent its device fields and their device types."""
        return needed_devices(self.program, self.team)

    @property
    def calls(self) -> Calls | None:
        """What its rules say of portal calls; None where every coordinator may call everything."""
        if not self.access.callers:
            return None
        return Calls(self.access, self.team.members, [m.name for m in self.program.core.methods])

    def devices_of(self, host: str) -> list[DeviceBinding]:
        """The devices of the agents that the deployment puts on a host."""
        return self.bindings.of([member.id for member in self.team.on(self.team.number(host))])

    def has_resources(self, host: str) -> bool:
        """Whether the deployment puts a resource on a host: a new start of a coordinator needs that host."""
        return any(member.kind == "resource" for member in self.team.on(self.team.number(host)))

    def vehicles_of(self, host: str) -> list[str]:
        """The devices of a host that say whether they are on the ground, by their names."""
        found = []
        for device in self.devices_of(host):
            driver = self.drivers.by_driver.get(device.driver)
            manifest = driver.manifests.get(device.type) if driver is not None else None
            if manifest is not None and any(each.name == ON_GROUND for each in manifest.device.telemetry):
                found.append(device.name)
        return found

    @property
    def world(self) -> World:
        """Whether its devices are fakes."""
        endpoints = [device.endpoint for device in self.bindings.all]
        if not endpoints:
            return ""
        return "fakes" if all(endpoint.startswith(SIMULATED) for endpoint in endpoints) else "hardware"

    @property
    def fenced(self) -> frozenset[str]:
        """The ids of coordinators that may be recovered elsewhere: they run only under a lease."""
        classes = fenced_classes(self.program)
        return frozenset(member.id for member in self.team.coordinators if member.type in classes)

    @property
    def recovery(self) -> Recovery:
        """Who decides that a fenced coordinator is lost; without one nobody does.

        Raises BindingError when they must be named and are not: whoever makes a mission has looked.
        """
        chosen = self.bindings.recovery
        return chosen.among(self.team.hosts) if self.fenced else replace(chosen, members=())

    def on_fakes(self) -> Mission:
        """The same mission with a fake for each device; which were chosen is added to its warnings."""
        needed, types = self.needed, self.team.types
        bindings = on_fakes(self.bindings, needed, self.drivers, types)
        chosen = chosen_fakes(bindings, needed, self.drivers, types)
        return replace(self, bindings=bindings, warnings=tuple(dict.fromkeys((*self.warnings, *chosen))))

    def at(self, team: Team) -> Mission:
        """The same mission with its team at other addresses."""
        return replace(self, team=team)

    def with_bindings(self, bindings: Bindings) -> Mission:
        """The same mission with other bindings."""
        return replace(self, bindings=bindings)


def placed(registry: Registry, types: Mapping[str, str], frames: Frames) -> Registry:
    """A registry in which agents of these `types` are where their poses say.

    What has telemetry of its place tells that; what the registry states of an agent counts before its pose.
    """
    agents = dict(registry.agents)
    for agent, pose in frames.agents.items():
        provider = registry.providers.get(types.get(agent, ""))
        if provider is None or not PLACE.isdisjoint(provider.live):
            continue
        where: dict[str, Value] = {"north": pose.north, "east": pose.east, "down": pose.down}
        agents[agent] = {**where, **registry.agents.get(agent, {})}
    return replace(registry, agents=agents)


def needed_devices(program: Program, team: Team) -> dict[str, dict[str, str]]:
    """For each agent of a team its device fields and their device types."""
    classes = {record.name: record for record in program.core.classes}
    return {m.id: {field.name: field.type for field in classes[m.type].devices} for m in team.members}


def makers_of(drivers: Drivers, types: Collection[str]) -> KnownDrivers:
    """The drivers that make some device types, with what is needed of them."""
    limited = ((name, driver.only(types)) for name, driver in sorted(drivers.by_driver.items()))
    return KnownDrivers({name: driver for name, driver in limited if driver.manifests})
