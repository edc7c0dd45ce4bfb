"""State of a team at one moment, as plain data: the result of `TeamView.snapshot`, shown by the web page.

Ages are in seconds since the last confirmation; the state of an unreachable host stays, and ages. Positions
are metres north, east and down in the frame of the team; angles are radians clockwise from north, degrees
only for latitude and longitude. None means that no host has reported it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, Protocol

from msgspec import Struct, field

from lfield.errors import LfieldError
from lfield.guard.standstill import UNCONFIRMED
from lfield.wire.fields import Telemetry
from lfield.wire.observer_messages import Status
from lfield.wire.order_messages import OrderKind

#: The report of a host that has sent none.
NO_REPORT = Status("", "", 0.0, b"", b"", [], [], [], [], [])


class TelemetryReading(NamedTuple):
    """A quantity of telemetry, `age` seconds old."""

    value: Telemetry
    age: float


class LocalPosition(NamedTuple):
    """Metres in the frame of the team; `down` is None if the height is unknown."""

    north: float
    east: float
    down: float | None = None


class GeoPosition(NamedTuple):
    """Degrees, and metres above mean sea level, None if unknown."""

    latitude: float
    longitude: float
    altitude: float | None = None


class LinkState(Struct, frozen=True):
    """Measurements of a host about one link: the round trip in seconds, the loss rate of sent segments, the
    bytes sent and received since the link opened, and the bytes of its messages by kind of traffic. `path`
    and `standby` are those of `LinkStatus`."""

    round_trip: float | None = None
    loss: float | None = None
    sent: int | None = None
    received: int | None = None
    kinds: Mapping[str, int] = field(default_factory=dict)
    path: str = ""
    standby: str = ""


class HostState(Struct, frozen=True):
    """The state of a host.

    `linked`: connected now; else `problem` is the reason and `age` the age (s) of its data, None if there was
    no contact. `uptime` is in seconds, and `jitter` the longest delay of its heartbeats to its guards in the
    last minute (s). `end_reason` is the reason of its end, if it reported one. `stopped` is the reason of an
    active emergency stop, '' for none. `paused`: an operator has paused the mission there; `held_by_vote`:
    the vote about an activation has. `links` are its links to other hosts with their measurements,
    `unreachable_for` the seconds since its last contact with each unreachable one. Coordinators not started
    yet wait for the hosts in `waits_for`, or for an operator because of `start_held`; `refused` are the hosts
    that it cannot link with, each with the reason. `awaiting_input` are its agents that wait for a line of
    input. `bundle` are the first digits of the digest of its bundle, '' for none. `lost_events` counts the
    lost events by kind. `clock_offset` is the offset of its clock to that of this computer (s) with
    `clock_uncertainty`. `position` is its position in the devices file. `error` is the error behind
    `problem`. `devices` are its devices by name. `report` is its last snapshot: read only fields that no
    event changes.
    """

    host: str
    linked: bool = False
    problem: str = ""
    age: float | None = None
    uptime: float | None = None
    restarts: int = 0
    end_reason: str | None = None
    stopped: str = ""
    paused: bool = False
    held_by_vote: bool = False
    waits_for: tuple[str, ...] = ()
    start_held: str = ""
    awaiting_input: tuple[str, ...] = ()
    refused: Mapping[str, str] = field(default_factory=dict)
    bundle: str = ""
    jitter: float | None = None
    links: Mapping[str, LinkState] = field(default_factory=dict)
    unreachable_for: Mapping[str, float] = field(default_factory=dict)
    lost_events: Mapping[str, int] = field(default_factory=dict)
    clock_offset: float | None = None
    clock_uncertainty: float | None = None
    position: LocalPosition | None = None
    error: LfieldError | None = None
    devices: Mapping[str, DeviceState] = field(default_factory=dict)
    report: Status = NO_REPORT


class DeviceState(Struct, frozen=True):
    """A device, `name` is AGENT.FIELD. `latched` is the reason why it is held in its safe state, or ''.

    `confirmed`: it is in that state; `moving` describes its movement there, '' at rest. `telemetry_age` is in
    seconds, None if there never was any telemetry. `has_safe_state` is None if unknown. A device that is not
    `fresh` is drawn grey: its host is unreachable.
    """

    name: str
    agent: str
    host: str
    fresh: bool
    has_safe_state: bool | None = None
    latched: str = ""
    confirmed: bool = False
    moving: str = ""
    telemetry_age: float | None = None
    readings: Mapping[str, TelemetryReading] = field(default_factory=dict)

    @property
    def motion(self) -> str:
        """The motion that remains; UNCONFIRMED in a safe state that is not confirmed, '' at rest."""
        return UNCONFIRMED if self.latched and not self.confirmed else self.moving

    @property
    def telemetry(self) -> dict[str, Telemetry]:
        """The values of its readings."""
        return {name: reading.value for name, reading in self.readings.items()}

    @property
    def at_rest(self) -> bool:
        """Whether the device is confirmed in its safe state and at rest."""
        return bool(self.latched) and self.confirmed and not self.moving


def agent_of(device: str) -> str:
    """The agent of a device: `alpha` of `alpha.fc`."""
    return device.rpartition(".")[0]


class VehicleState(Struct, frozen=True):
    """A resource with devices as a vehicle: the readings of its devices by meaning.

    `position` and `geo_position` are measured or derived with the origin of the team, and `position_age`
    seconds old; None for an agent without a position. `is_position_stated`: never measured, but stated in the
    devices file. `height` is above the starting point (m), `battery` from 0 to 1, `heading` in radians.
    `telemetry_age` is the age of its newest telemetry (s). `radius` and `ceiling` are the limits of its
    binding, metres from and above its `home`; `fence` is the radius of the fence of its autopilot, None
    without one.
    """

    agent: str
    type: str
    host: str
    fresh: bool
    position: LocalPosition | None = None
    geo_position: GeoPosition | None = None
    position_age: float | None = None
    is_position_stated: bool = False
    heading: float | None = None
    speed: float | None = None
    height: float | None = None
    battery: float | None = None
    mode: str = ""
    armed: bool | None = None
    telemetry_age: float | None = None
    refusal: str = ""
    devices: tuple[DeviceState, ...] = ()
    home: GeoPosition | None = None
    radius: float | None = None
    ceiling: float | None = None
    fence: float | None = None

    @property
    def latched(self) -> bool:
        """Whether one of its devices is held in its safe state."""
        return any(device.latched for device in self.devices)


class HopState(Struct, frozen=True):
    """A hop from one host to another, started `age` seconds ago, for the call of RESOURCE.PORTAL.

    `duration` is in seconds as measured by the sender, None while unknown. `number` is that of the transfer.
    `failure` is the reason why it did not arrive, '' otherwise.
    """

    number: int
    source: str
    target: str
    age: float
    resource: str = ""
    portal: str = ""
    size: int = 0
    duration: float | None = None
    failure: str = ""


class AgentState(Struct, frozen=True):
    """An agent. `host` is the host where it last ran; `target` is the destination of its hop, '' if not in
    transit.

    `state` is its activity in a word, `file` and `line` its position in the program (0: unknown), `waits_for`
    the portal or instruction that it waits for. `finished` is its end: '', done, died, lost, superseded, with
    the `detail`. `doubt` is the reason why its state is unknown. `hops` counts all, None for one that ended
    before this computer watched, unless its last host reports it; `trail` are the last hops, newest last.
    """

    agent: str
    type: str
    kind: Literal["coordinator", "resource"]
    host: str
    fresh: bool
    age: float | None = None
    generation: int = 0
    hops: int | None = 0
    served: int = 0
    target: str = ""
    state: str = ""
    file: str = ""
    line: int = 0
    waits_for: str = ""
    finished: str = ""
    detail: str = ""
    doubt: str = ""
    trail: tuple[HopState, ...] = ()


class OfferState(Struct, frozen=True):
    """Whether an agent can be called, as reported by the host `reported_by`: its own if linked, else any.

    `refusal` is the reason why not, '' if it can. `other_reports` are the hosts that report
    otherwise, with their reasons.
    """

    agent: str
    type: str
    reported_by: str
    refusal: str
    fresh: bool
    other_reports: Mapping[str, str] = field(default_factory=dict)


class ShownLogLine(NamedTuple):
    """A line of a host's log; `agent` is its author, '' for the host itself.

    `at` (s since 1970) and `tick` are its timestamp: the log is in the order of timestamp, host and serial.
    `serial` counts the lines from 1 in the order of arrival, so that only new ones need be drawn. Within a
    host both orders are the same.
    """

    serial: int
    host: str
    at: float
    age: float
    agent: str
    text: str
    tick: int = 0


class StopState(Struct, frozen=True):
    """An emergency stop in force on some host, or sent from here: confirmed and unconfirmed devices.

    `hosts` are those where it is in force. `confirmed` and `unconfirmed` are their devices, the latter with
    the reason; `unreached` are hosts that should have stopped without confirmation, with the reason.
    `pending` are hosts that have not answered the order from here yet. `stopped_before` are unreachable hosts
    that had stopped when they were last linked, with the devices that were safe then.
    """

    reason: str = ""
    by: str = ""
    age: float | None = None
    hosts: tuple[str, ...] = ()
    confirmed: tuple[str, ...] = ()
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    unreached: Mapping[str, str] = field(default_factory=dict)
    pending: tuple[str, ...] = ()
    stopped_before: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def is_active(self) -> bool:
        """Whether a stop is in force on some linked host."""
        return bool(self.hosts)

    @property
    def is_complete(self) -> bool:
        """Whether every device of every host of the team is confirmed safe."""
        is_open = self.unconfirmed or self.unreached or self.pending or self.stopped_before
        return self.is_active and not is_open


class OrderState(Struct, frozen=True):
    """The result of an order that was sent from here `age` seconds ago, as far as it is still true.

    `pending` are the hosts that have not answered yet, `done` those that have executed it, `unreached` those
    that have not as far as is known, with the reasons. `unconfirmed` are devices that are not safe yet, and
    `warnings` are those of hosts. `number` counts all orders from 1.
    """

    number: int
    order: OrderKind
    age: float
    pending: tuple[str, ...] = ()
    done: tuple[str, ...] = ()
    unreached: Mapping[str, str] = field(default_factory=dict)
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    warnings: Mapping[str, str] = field(default_factory=dict)


class Curve(Struct, frozen=True):
    """A quantity of the last minutes: pairs of seconds before now and value, oldest first. `hops` are
    per minute."""

    quantity: Literal["battery", "height", "link", "hops"]
    agent: str
    points: tuple[tuple[float, float], ...]


class TrackPoint(NamedTuple):
    """A point of a track: metres north and east in the frame of the team, and degrees, as far as known."""

    position: tuple[float, float] | None
    geo_position: tuple[float, float] | None


class AgentTrack(NamedTuple):
    """Points of the track of a vehicle, oldest first."""

    agent: str
    points: list[TrackPoint]


class TrackUpdate(NamedTuple):
    """The points after a number, `newest` is that of the last one. `is_whole`: all of them."""

    newest: int
    is_whole: bool
    tracks: list[AgentTrack]


class TeamState(Struct, frozen=True):
    """The state of a whole team. `revision` grows with every change except ages."""

    team: str
    revision: int
    hosts: Mapping[str, HostState]
    vehicles: Mapping[str, VehicleState]
    agents: Mapping[str, AgentState]
    offers: Mapping[str, OfferState]
    stop: StopState
    log: tuple[ShownLogLine, ...]
    #: The last order about stops, and the last one about pauses.
    orders: tuple[OrderState, ...] = ()

    @property
    def coordinators(self) -> Mapping[str, AgentState]:
        """The agents that move between hosts."""
        return {name: agent for name, agent in self.agents.items() if agent.kind == "coordinator"}

    @property
    def paused(self) -> tuple[str, ...]:
        """The linked hosts where the mission is paused."""
        return tuple(name for name, host in self.hosts.items() if host.paused and host.linked)


class TeamStateSource(Protocol):
    """A source of team states: a follower of its hosts, or a script of a test."""

    def snapshot(self) -> TeamState:
        """The present state. Cheap enough for five calls per second."""

    def curves(self) -> tuple[Curve, ...]:
        """The curves of the last minutes."""

    def tracks(self, after: int) -> TrackUpdate:
        """The tracks of the vehicles after a point number."""
