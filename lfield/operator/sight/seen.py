"""What is known of a team at one moment, as plain data: what `Picture.seen` gives, and what a page shows.

Ages are in seconds and are counted from when the last word of it was true; what a host that is gone has said
stays, and grows older. Places are metres north, east and down in the frame of the team; angles are radians
clockwise from north, degrees for latitude and longitude only. None is what nobody has told.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol

from lfield.operator.sight.actions import Order
from lfield.wire.fields import Telemetry


class Reading(NamedTuple):
    """A quantity of telemetry as a device told it, `age` seconds ago."""

    value: Telemetry
    age: float


class Local(NamedTuple):
    """Metres in the frame of the team; `down` is None where nothing tells the height."""

    north: float
    east: float
    down: float | None = None


class Earth(NamedTuple):
    """Degrees, and metres above mean sea level, None where nothing tells them."""

    latitude: float
    longitude: float
    altitude: float | None = None


@dataclass(frozen=True, slots=True)
class LinkSeen:
    """What a host measures of a link: the round trip in seconds, the share of what it sends that is lost, and
    the bytes sent and received since the link was made."""

    round_trip: float | None = None
    loss: float | None = None
    sent: int | None = None
    received: int | None = None


@dataclass(frozen=True, slots=True)
class HostSeen:
    """A host. `linked`: we hear it now; else `trouble` says why not, and what it told is as old as `age`.

    `age` is None for one that was never heard. `ending` is why it ends or has ended, where it said so.
    `stopped` is the reason of an emergency stop that stands there, '' for none. `links` are the hosts that
    it has links with, and what it measures of them, `away` those it misses, for how many seconds.
    Coordinators that are not started yet wait for the hosts in `waits_for`, or for an operator's command
    because of `start_held`; `refused` are the hosts that it cannot be linked with, each with the reason.
    `bundle` are the first digits of the digest of the bundle that it runs, '' for none. `lost` says by kind
    how much of what happened there this computer will never hear of, since it looks. `clock` is what its
    clock shows more than that of this computer (s), and `clock_within` how sure that is. `place` is what the
    devices file says.
    """

    host: str
    linked: bool = False
    trouble: str = ""
    age: float | None = None
    up: float | None = None
    restarts: int = 0
    ending: str | None = None
    stopped: str = ""
    paused: bool = False
    waits_for: tuple[str, ...] = ()
    start_held: str = ""
    refused: Mapping[str, str] = field(default_factory=dict)
    bundle: str = ""
    late: float | None = None
    links: Mapping[str, LinkSeen] = field(default_factory=dict)
    away: Mapping[str, float] = field(default_factory=dict)
    lost: Mapping[str, int] = field(default_factory=dict)
    clock: float | None = None
    clock_within: float | None = None
    place: Local | None = None

    @property
    def known(self) -> bool:
        """Whether it has ever said anything."""
        return self.age is not None


@dataclass(frozen=True, slots=True)
class DeviceSeen:
    """A device, `name` is AGENT.FIELD. `latched` is why it is held in its safe state, '' when it is in use.

    `confirmed`: it is in that state; `moving` is what it still does there, '' at rest. `silent` is for how
    long it has not been heard, None if it never was. `moves` is whether it has a safe state at all, None
    where nobody has said. A page draws what is not `fresh` greyed: its host is not heard.
    """

    name: str
    agent: str
    host: str
    fresh: bool
    moves: bool | None = None
    latched: str = ""
    confirmed: bool = False
    moving: str = ""
    silent: float | None = None
    readings: Mapping[str, Reading] = field(default_factory=dict)

    @property
    def at_rest(self) -> bool:
        """Whether it was seen to be in its safe state, doing nothing any more."""
        return bool(self.latched) and self.confirmed and not self.moving


@dataclass(frozen=True, slots=True)
class VehicleSeen:
    """A resource that has devices, as an operator looks at it: what its devices tell, by what it means.

    `place` and `earth` are where it is, each where it is told or follows from the origin of the team, and
    `measured` seconds old; None for one that has no position. `stated`: it was never measured, the devices
    file says so. `height` is above where it started (m), `battery` from 0 to 1, `heading` in radians. `link`
    is the age of its newest telemetry (s).
    """

    agent: str
    type: str
    host: str
    fresh: bool
    place: Local | None = None
    earth: Earth | None = None
    measured: float | None = None
    stated: bool = False
    heading: float | None = None
    speed: float | None = None
    height: float | None = None
    battery: float | None = None
    mode: str = ""
    armed: bool | None = None
    link: float | None = None
    refusal: str = ""
    devices: tuple[DeviceSeen, ...] = ()

    @property
    def latched(self) -> bool:
        """Whether one of its devices is held in its safe state."""
        return any(device.latched for device in self.devices)


@dataclass(frozen=True, slots=True)
class HopSeen:
    """A hop `of` one host `to` another, begun `age` seconds ago; for the call of RESOURCE.PORTAL.

    `seconds` is how long it took as its sender saw it, None as long as that is not known. `number` is the
    transfer's. `failed` is why it did not come there, '' else.
    """

    number: int
    of: str
    to: str
    age: float
    resource: str = ""
    portal: str = ""
    size: int = 0
    seconds: float | None = None
    failed: str = ""


@dataclass(frozen=True, slots=True)
class AgentSeen:
    """An agent. `host` is where it was heard to run last; `to` is where it is on its way, '' when it is not.

    `state` is a word for what it does, `file` and `line` are where in its program it stands (0: not told),
    `waits` is the portal or instruction that it waits for. `finished` is how it ended: '', done, died, lost,
    superseded, with the `detail`. `doubt` is why nobody knows whether it lives. `hops` counts all, None for
    one that has ended before anybody looked, while its last host tells nothing; `trail` are the last, the
    newest last.
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
    to: str = ""
    state: str = ""
    file: str = ""
    line: int = 0
    waits: str = ""
    finished: str = ""
    detail: str = ""
    doubt: str = ""
    trail: tuple[HopSeen, ...] = ()


@dataclass(frozen=True, slots=True)
class OfferSeen:
    """Whether an agent can be called, as the host `told_by` knows it: its own where that is heard, else any.

    `refusal` is why not, '' when it can. `apart` are the hosts that see it otherwise, with their reasons.
    """

    agent: str
    type: str
    told_by: str
    refusal: str
    fresh: bool
    apart: Mapping[str, str] = field(default_factory=dict)


class LogLine(NamedTuple):
    """A line of a host's log; `agent` is who said it, '' for the host itself.

    `at` is when that was by the clock of this computer (s since 1970), as well as it knows that of the host:
    one time line for all. `serial` counts the lines of this picture from 1 in the order in which they came,
    so that only new ones need be drawn. Within a host both orders are the same.
    """

    serial: int
    host: str
    at: float
    age: float
    agent: str
    text: str


@dataclass(frozen=True, slots=True)
class StopSeen:
    """An emergency stop that stands on some host, or was pressed from here: who has confirmed, who has not.

    `hosts` are those where it stands. `confirmed` and `unconfirmed` are their devices, the latter with the
    reason; `unreached` are hosts that should have stopped and of which nobody knows it, with the reason.
    `asked` are hosts that have not answered the press from here yet, whatever else they have said. `before`
    are hosts that are not heard and had stopped when they were, with what was safe then.
    """

    reason: str = ""
    by: str = ""
    age: float | None = None
    hosts: tuple[str, ...] = ()
    confirmed: tuple[str, ...] = ()
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    unreached: Mapping[str, str] = field(default_factory=dict)
    asked: tuple[str, ...] = ()
    before: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def stands(self) -> bool:
        """Whether devices may not be released on some host that is heard."""
        return bool(self.hosts)

    @property
    def complete(self) -> bool:
        """Whether every device of every host of the team is seen to be safe."""
        return self.stands and not (self.unconfirmed or self.unreached or self.asked or self.before)


@dataclass(frozen=True, slots=True)
class OrderSeen:
    """What came of an order that was given from here `age` seconds ago, as far as it is true still.

    `asked` are the hosts that have not answered yet, `done` those that have done it, `unreached` those that
    have not as far as anybody knows, with the reasons. `unconfirmed` are devices that are not safe yet, and
    `troubles` what hosts had to say besides. `number` counts all orders from 1.
    """

    number: int
    order: Order
    age: float
    asked: tuple[str, ...] = ()
    done: tuple[str, ...] = ()
    unreached: Mapping[str, str] = field(default_factory=dict)
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    troubles: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Curve:
    """A quantity of the last minutes: pairs of seconds before now (0 is now, growing older) and value, the
    oldest first. `what` is battery, height, link or hops (a minute), `of` the agent."""

    what: Literal["battery", "height", "link", "hops"]
    of: str
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Seen:
    """All of it. `revision` grows when something has changed, but for ages."""

    team: str
    revision: int
    hosts: Mapping[str, HostSeen]
    vehicles: Mapping[str, VehicleSeen]
    agents: Mapping[str, AgentSeen]
    offers: Mapping[str, OfferSeen]
    stop: StopSeen
    log: tuple[LogLine, ...]
    #: The last one about stops, and the last one about pauses.
    orders: tuple[OrderSeen, ...] = ()

    @property
    def coordinators(self) -> Mapping[str, AgentSeen]:
        """The agents that move."""
        return {name: agent for name, agent in self.agents.items() if agent.kind == "coordinator"}

    @property
    def paused(self) -> tuple[str, ...]:
        """The hosts where the mission is paused, of those that are heard."""
        return tuple(name for name, host in self.hosts.items() if host.paused and host.linked)


class Sight(Protocol):
    """Whoever can say how a team is: a follower of its hosts, or a script of a test."""

    def seen(self) -> Seen:
        """How it is now. Cheap enough for five times a second."""

    def curves(self) -> tuple[Curve, ...]:
        """What is plotted, of the last minutes."""
