"""A team of two copters by hand, and batches of events as its hosts would send them."""

from __future__ import annotations

from lfield.mission.bindings import Frames
from lfield.operator.sight.picture.places import Instruments
from lfield.operator.sight.picture.roll import Enrolled, Roll
from lfield.wire.events import Event, Measured, Standing, State
from lfield.wire.fields import Telemetry
from lfield.wire.observing import (
    AgentStatus,
    DeviceStatus,
    LinkStatus,
    Status,
    Told,
)
from lfield.wire.watching import Events

COPTER = Instruments(moves=True)
LIFE = 7


def roll(frames: Frames | None = None) -> Roll:
    """alpha and beta with a copter each, and a coordinator that begins on alpha."""
    agents = {
        "one": Enrolled("one", "Copter", "alpha", "resource"),
        "two": Enrolled("two", "Copter", "beta", "resource"),
        "boss": Enrolled("boss", "Boss", "alpha", "coordinator"),
    }
    devices = {"one.fc": COPTER, "two.fc": COPTER}
    return Roll("team", ("alpha", "beta"), agents, devices, frames or Frames())


class Teller:
    """A host that tells: each batch at a time of its own monotonic clock, `wall` seconds from Unix time."""

    def __init__(self, incarnation: int = LIFE, wall: float = 1.7e9) -> None:
        self.incarnation, self.wall = incarnation, wall
        self.number = self.batches = 0

    def event(self, up: float, what: State | Measured | Standing, cause: int = 0) -> Event:
        """The next one."""
        self.number += not isinstance(what, Measured | Standing)
        return Event(self.number, self.wall + up, up, cause, what)

    def batch(
        self,
        up: float,
        *whats: State | Measured | Standing,
        lost: dict[str, int] | None = None,
        snapshot: Status | None = None,
    ) -> Events:
        """What happened at that time, in a batch that is sent at once."""
        after = self.number
        told = [self.event(up, what) for what in whats]
        self.batches += 1
        return Events(
            self.incarnation, self.batches, self.wall + up, up, after, self.number, told, lost or {}, snapshot
        )


def device(name: str, latched: str = "", moving: str = "", **telemetry: Telemetry) -> DeviceStatus:
    """A device in a snapshot, heard just now."""
    return DeviceStatus(name, dict(telemetry), 0.0, latched, moving)


def resource(name: str) -> AgentStatus:
    """A resource in a snapshot."""
    return AgentStatus(name, "Copter", "resource", "idle", 0, 3, 100, 1000, 0)


def snapshot(host: str, *devices: DeviceStatus, agents: list[AgentStatus] | None = None) -> Status:
    """How a host is: linked with the other, its directory knows both copters."""
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
        directory=[Told("one", "", {}, {}), Told("two", "", {}, {})],
    )
