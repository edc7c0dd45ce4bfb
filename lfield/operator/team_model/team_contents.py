"""The parts of a team by its files: agents, hosts, devices with quantities, positions. Sans-IO."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from msgspec import Struct, field

from lfield.driver.driver_index import DriverLookup
from lfield.driver.frame import Origin
from lfield.mission.bindings import Frames
from lfield.mission.mission import Mission
from lfield.mission.team import Team
from lfield.operator.team_model.team_state import LocalPosition, agent_of
from lfield.operator.team_model.vehicle_readings import DEFAULT_INSTRUMENTS, Instruments, instruments_of

AgentKind = Literal["coordinator", "resource"]


class TeamEntry(Struct, frozen=True):
    """An agent of the deployment: its type in L, and the host on which it starts. `kind` is '' if only the
    program defines it."""

    agent: str
    type: str
    host: str
    kind: AgentKind | Literal[""] = ""


class TeamContents(Struct, frozen=True):
    """A team: its `hosts` in order, its agents, and its devices (AGENT.FIELD) with their quantities."""

    team: str
    hosts: tuple[str, ...]
    agents: Mapping[str, TeamEntry] = field(default_factory=dict)
    devices: Mapping[str, Instruments] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)
    #: The limits of bindings, by device.
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def origin(self) -> Origin | None:
        """The origin of the team's frame on the Earth."""
        return self.frames.origin

    def instruments(self, device: str) -> Instruments:
        """The quantities of a device, from its manifest if available."""
        return self.devices.get(device, DEFAULT_INSTRUMENTS)

    def safe_state_flags(self, host: str) -> Mapping[str, bool | None]:
        """The devices of a host, with whether each has a safe state."""
        own = {agent.agent for agent in self.agents.values() if agent.host == host}
        return {name: device.has_safe_state for name, device in self.devices.items() if agent_of(name) in own}

    def host_place(self, host: str) -> LocalPosition | None:
        """The position of a host in the devices file."""
        place = self.frames.place(host)
        return None if place is None else LocalPosition(*place)

    def agent_place(self, agent: str) -> LocalPosition | None:
        """The position of an agent in the devices file, which is the origin of its own frame."""
        pose = self.frames.agents.get(agent)
        return None if pose is None else LocalPosition(pose.north, pose.east, pose.down)


def team_contents(name: str, team: Team, mission: Mission | None = None) -> TeamContents:
    """The contents of a team; its mission adds devices, frames, and kinds of agents."""
    agents = {}
    for member in team.members:
        kind: AgentKind = "coordinator" if member.kind == "coordinator" else "resource"
        agents[member.id] = TeamEntry(
            member.id, member.type, team.hosts[member.host], kind if mission is not None else ""
        )
    if mission is None:
        return TeamContents(name, team.hosts, agents)
    known = _instruments(mission.drivers)
    devices = {device.name: known[device.type] for device in mission.bindings.all if device.type in known}
    limits = {device.name: device.limits for device in mission.bindings.all}
    return TeamContents(name, team.hosts, agents, devices, mission.bindings.frames, limits)


def _instruments(drivers: DriverLookup) -> Mapping[str, Instruments]:
    """The quantities of each device type."""
    return {
        type: instruments_of(manifest.device)
        for driver in drivers.by_driver.values()
        for type, manifest in driver.manifests.items()
    }
