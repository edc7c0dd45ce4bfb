"""Who is in a team by its files: agents, hosts, devices and what they tell, and where they stand. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from lfield.driver.frame import Origin
from lfield.driver.known import Drivers
from lfield.mission.bindings import Frames
from lfield.mission.mission import Mission
from lfield.mission.team import Team
from lfield.operator.sight.picture.places import Instruments, instruments_of
from lfield.operator.sight.seen import Local

Kind = Literal["coordinator", "resource"]


@dataclass(frozen=True, slots=True)
class Enrolled:
    """An agent of the deployment: its type in L, and the host that it begins on. `kind` is '' where only the
    program would say it."""

    agent: str
    type: str
    host: str
    kind: Kind | Literal[""] = ""


@dataclass(frozen=True, slots=True)
class Roll:
    """A team: its `hosts` in their order, its agents, and its devices (AGENT.FIELD) with what they tell."""

    team: str
    hosts: tuple[str, ...]
    agents: Mapping[str, Enrolled] = field(default_factory=dict)
    devices: Mapping[str, Instruments] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)

    @property
    def origin(self) -> Origin | None:
        """Where on the Earth the team counts places from."""
        return self.frames.origin

    def host_place(self, host: str) -> Local | None:
        """Where the devices file says that a host is."""
        place = self.frames.place(host)
        return None if place is None else Local(*place)

    def agent_place(self, agent: str) -> Local | None:
        """Where it says that an agent is: its own frame begins there."""
        pose = self.frames.agents.get(agent)
        return None if pose is None else Local(pose.north, pose.east, pose.down)


def roll_of(name: str, team: Team, mission: Mission | None = None) -> Roll:
    """The roll of a team; with its mission it knows devices, frames, and kinds of agents."""
    agents = {}
    for member in team.members:
        kind: Kind = "coordinator" if member.kind == "coordinator" else "resource"
        agents[member.id] = Enrolled(
            member.id, member.type, team.hosts[member.host], kind if mission is not None else ""
        )
    if mission is None:
        return Roll(name, team.hosts, agents)
    known = _instruments(mission.drivers)
    devices = {device.name: known[device.type] for device in mission.bindings.all if device.type in known}
    return Roll(name, team.hosts, agents, devices, mission.bindings.frames)


def _instruments(drivers: Drivers) -> Mapping[str, Instruments]:
    """By device type."""
    return {
        type: instruments_of(manifest.device)
        for driver in drivers.by_driver.values()
        for type, manifest in driver.manifests.items()
    }
