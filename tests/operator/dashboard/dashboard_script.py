"""A scripted team of two copters, and batches of events in the form of its hosts."""

from __future__ import annotations

from lfield.mission.bindings import Frames
from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.vehicle_readings import Instruments
from lfield.wire.events import AgentActivity, DeviceTelemetry, Event, StateEvent
from lfield.wire.fields import Telemetry
from lfield.wire.observer_messages import (
    AgentStatus,
    DeviceStatus,
    DirectoryEntry,
    LinkStatus,
    Status,
)
from lfield.wire.subscription_messages import EventBatch

COPTER = Instruments(has_safe_state=True)
INCARNATION = 7


def inventory(frames: Frames | None = None) -> TeamContents:
    """alpha and beta with a copter each, and a coordinator that starts on alpha."""
    agents = {
        "one": TeamEntry("one", "Copter", "alpha", "resource"),
        "two": TeamEntry("two", "Copter", "beta", "resource"),
        "boss": TeamEntry("boss", "Boss", "alpha", "coordinator"),
    }
    devices = {"one.fc": COPTER, "two.fc": COPTER}
    return TeamContents("team", ("alpha", "beta"), agents, devices, frames or Frames())


class ScriptedHost:
    """A host that sends event batches: each batch at a time of its own monotonic clock, `wall` seconds from
    Unix time.
    """

    def __init__(self, incarnation: int = INCARNATION, wall: float = 1.7e9) -> None:
        self.incarnation, self.wall = incarnation, wall
        self.number = self.batches = 0

    def event(self, up: float, what: StateEvent | DeviceTelemetry | AgentActivity, cause: int = 0) -> Event:
        """The next event."""
        self.number += not isinstance(what, DeviceTelemetry | AgentActivity)
        return Event(self.number, self.wall + up, up, cause, what)

    def batch(
        self,
        up: float,
        *whats: StateEvent | DeviceTelemetry | AgentActivity,
        lost: dict[str, int] | None = None,
        snapshot: Status | None = None,
    ) -> EventBatch:
        """Events of that time, in a batch that is sent immediately."""
        after = self.number
        events = [self.event(up, what) for what in whats]
        self.batches += 1
        return EventBatch(
            self.incarnation,
            self.batches,
            self.wall + up,
            up,
            after,
            self.number,
            events,
            lost or {},
            snapshot,
        )


def device(name: str, latched: str = "", moving: str = "", **telemetry: Telemetry) -> DeviceStatus:
    """A device in a snapshot, received just now."""
    return DeviceStatus(name, dict(telemetry), 0.0, latched, moving)


def resource(name: str) -> AgentStatus:
    """A resource in a snapshot."""
    return AgentStatus(name, "Copter", "resource", "idle", 0, 3, 100, 1000, 0)


def snapshot(host: str, *devices: DeviceStatus, agents: list[AgentStatus] | None = None) -> Status:
    """The snapshot of a host: linked with the other host, its directory knows both copters."""
    other = "beta" if host == "alpha" else "alpha"
    return Status(
        host=host,
        address=f"{host}:8181",
        up=5.0,
        program=b"p",
        deployment=b"d",
        agents=agents or [],
        coordinators=[],
        devices=list(devices),
        links=[LinkStatus(other, None)],
        directory=[DirectoryEntry("one", "", {}, {}), DirectoryEntry("two", "", {}, {})],
    )
