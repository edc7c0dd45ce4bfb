"""What is known of a team now: events of all its hosts in, `Seen` out. Pure (decision 67).

`now` is always the monotonic clock of this computer in seconds, `wall` its Unix time. What a host told before
its link broke stays, and grows older; a new life of a host begins with nothing of what the last one did.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from lfield.driver.frame import Origin
from lfield.errors import AddressError, LfieldError
from lfield.operator.sight.actions import Order
from lfield.operator.sight.picture.agents import AgentEvent, Agents
from lfield.operator.sight.picture.curves import Curves
from lfield.operator.sight.picture.devices import DeviceEvent, Devices, earth_of, vehicle_of
from lfield.operator.sight.picture.loglines import LogLines, Said, Words
from lfield.operator.sight.picture.presses import Presses
from lfield.operator.sight.picture.roll import Roll
from lfield.operator.sight.seen import (
    Curve,
    DeviceSeen,
    HostSeen,
    LinkSeen,
    OfferSeen,
    OrderSeen,
    Seen,
    StopSeen,
    VehicleSeen,
)
from lfield.wire import events
from lfield.wire.events import Event
from lfield.wire.fields import short_digest
from lfield.wire.observing import EmergencyStopped, LinkStatus, Status
from lfield.wire.watching import Events

#: Clocks of computers go apart by no more than so many seconds in a second.
DRIFT = 2e-4


@dataclass(slots=True)
class _Host:
    """What is known of one. `told` is when it said something last, `clock` how our clock differs from its own
    monotonic one, by the quickest batch so far."""

    linked: bool = False
    trouble: str = "not heard yet"
    told: float | None = None
    incarnation: int = 0
    restarts: int = 0
    up: float = 0.0
    clock: float | None = None
    wall: float | None = None
    within: float | None = None
    ending: str | None = None
    stopped: str = ""
    stopped_by: str = ""
    stopped_at: float | None = None
    paused: bool = False
    waits_for: tuple[str, ...] = ()
    start_held: str = ""
    refused: dict[str, str] = field(default_factory=dict)
    bundle: str = ""
    late: float | None = None
    links: dict[str, LinkSeen] = field(default_factory=dict)
    away: dict[str, float] = field(default_factory=dict)
    offers: dict[str, str] = field(default_factory=dict)
    lost: Counter[str] = field(default_factory=Counter)
    refusals: Mapping[str, str] = field(default_factory=dict)
    #: The number of the last event before those that came here.
    begins: int | None = None
    #: The number of the last event that a snapshot has told what came of.
    past: int = 0

    def when(self, up: float, now: float) -> float:
        """When that was on our clock, what its own showed then; not later than now."""
        return now if self.clock is None else min(now, up + self.clock)


class Picture:
    """The picture of one team. By so many seconds (`ahead`) Unix time is ahead of our monotonic clock, here
    and as long as this lasts."""

    def __init__(self, roll: Roll, ahead: float = 0.0) -> None:
        self.roll = roll
        self.revision = 0
        self._hosts = {host: _Host() for host in roll.hosts}
        self._agents, self._devices = Agents(roll), Devices(roll)
        self._log, self._curves, self._presses = LogLines(ahead), Curves(), Presses()
        self._origin = roll.origin

    # --- in -------------------------------------------------------------------------------------------

    def linked(self, name: str) -> None:
        """There is a link to a host."""
        host = self._host(name)
        host.linked, host.trouble = True, ""
        self._agents.linked(name)

    def unlinked(self, name: str, why: str) -> None:
        """There is none, or none any more."""
        host = self._host(name)
        host.linked, host.trouble = False, why
        self._agents.unlinked(name)

    def told(self, name: str, batch: Events, now: float, wall: float, took: float | None = None) -> None:
        """What a host has sent. `took` is how long it was asked for, of a first answer: for that long nobody
        knows what its clock showed."""
        host = self._life(name, batch.incarnation)
        host.begins = batch.after if host.begins is None else host.begins
        host.told, host.up = now, batch.up
        behind = now - batch.up
        host.clock = behind if host.clock is None else min(behind, host.clock + DRIFT)
        if took is not None or host.wall is None:
            host.wall, host.within = batch.now - wall, took
        host.lost.update(batch.lost)
        for event in batch.events:
            self._happened(name, host, event, now)
        if batch.snapshot is not None:
            self._status(name, host, batch.snapshot, now)
            host.past = batch.latest

    def log_waits(self) -> None:
        """The log begins with what hosts have said before they are heard here: it waits for that."""
        self._log.hold()

    def log_begins(self, before: Iterable[tuple[str, int, Event, float]]) -> None:
        """That is what was said: of each host, in that life of it, an event, and when on our clock it was."""
        self.revision += 1
        told = []
        for name, incarnation, event, when in before:
            host, what = self._host(name), event.what
            comes = host.begins is not None and event.number > host.begins
            if isinstance(what, Words) and not (comes and host.incarnation == incarnation):
                told.append(Said(name, when, what))
                _left_out(host, what)
        self._log.begin(told)

    def ordered(self, order: Order, hosts: Collection[str], now: float) -> int:
        """An order is given from here to those hosts, and to those of the team of which nobody knows where
        they are; its number."""
        self.revision += 1
        number = self._presses.ordered(order, [*self._hosts, *(set(hosts) - set(self._hosts))], now)
        for name in set(self._hosts) - set(hosts):
            self._presses.answered(number, name, AddressError(name, "nobody knows where it is"))
        return number

    def answered(self, number: int, name: str, answer: EmergencyStopped | LfieldError) -> None:
        """What a host has said to an order: the devices that are not safe, with the reasons; or why it was
        not reached."""
        host = self._host(name)
        self._presses.answered(number, name, answer)
        if isinstance(answer, EmergencyStopped):
            self._devices.movable(name, answer.devices)
            host.refusals = {device: why for device, why in answer.devices.items() if why}

    def tick(self, now: float) -> None:
        """Once a second or so: curves grow also while nobody looks."""
        self._curves.add(now, self.seen(now).vehicles, self._agents.hops_a_minute(now))

    def _host(self, name: str) -> _Host:
        self.revision += 1
        if name not in self._hosts:
            self._hosts[name] = _Host()
        return self._hosts[name]

    def _life(self, name: str, incarnation: int) -> _Host:
        """A host in that life of it. What stood in another one is over, and its clock may be another."""
        host = self._host(name)
        if host.incarnation not in (0, incarnation):
            host = self._hosts[name] = _Host(lost=host.lost, restarts=host.restarts + 1)
            self._agents.restarted(name)
            self._devices.restarted(name)
        host.incarnation, host.linked, host.trouble = incarnation, True, ""
        return host

    def _status(self, name: str, host: _Host, status: Status, now: float) -> None:
        host.paused, host.late = status.paused, status.late
        host.stopped = status.stopped
        host.refused = {refused.host: refused.reason for refused in status.refused}
        host.bundle = short_digest(status.bundle.digest) if status.bundle is not None else ""
        host.waits_for = tuple(status.start.hosts) if status.start is not None else ()
        host.start_held = status.start.held if status.start is not None else ""
        host.links = {link.host: _measured(link) for link in status.links if link.away is None}
        host.away = {link.host: now - link.away for link in status.links if link.away is not None}
        host.offers = {told.agent: told.refusal for told in status.directory}
        self._devices.status(name, status.devices, now)
        self._agents.status(name, status.agents, status.coordinators, now)

    def _happened(self, name: str, host: _Host, event: Event, now: float) -> None:
        when, what = host.when(event.up, now), event.what
        is_past = event.number <= host.past and not isinstance(what, events.Thinned)
        if isinstance(what, AgentEvent):
            self._agents.told(name, what, when, is_past=is_past)
        elif isinstance(what, Words):
            self._log.add(Said(name, when, what))
            _left_out(host, what)
        elif is_past:
            _began(host, what, when)
        elif isinstance(what, DeviceEvent):
            self._devices.told(name, what, when)
        elif isinstance(what, events.Ended):
            self._agents.served(name, what.resource)
        else:
            self._countermanded(what, when)
            _stands(host, what, when)

    def _countermanded(self, what: object, when: float) -> None:
        match what:
            case events.Stopped(_, _, lifted):
                self._presses.happened("lift" if lifted else "stop", when)
            case events.Paused(_, lifted):
                self._presses.happened("resume" if lifted else "pause", when)
            case _:
                pass

    # --- out ------------------------------------------------------------------------------------------

    def curves(self, now: float) -> tuple[Curve, ...]:
        """What is plotted."""
        return self._curves.seen(now)

    def seen(self, now: float) -> Seen:
        """All that is known at that moment."""
        fresh = {name: host.linked for name, host in self._hosts.items()}
        devices = self._devices.seen(now, fresh)
        offers = self._offers(fresh)
        hosts = {name: self._seen(name, host, now) for name, host in self._hosts.items()}
        orders = self._presses.seen(now, hosts, self._devices.unsafe)
        return Seen(
            team=self.roll.team,
            revision=self.revision,
            hosts=hosts,
            vehicles=self._vehicles(devices, offers),
            agents=self._agents.seen(now, fresh),
            offers=offers,
            stop=self._stop(now, orders),
            log=self._log.seen(now),
            orders=orders,
        )

    def _vehicles(
        self, devices: Mapping[str, tuple[DeviceSeen, ...]], offers: Mapping[str, OfferSeen]
    ) -> dict[str, VehicleSeen]:
        self._take_origin(devices)
        found = {}
        for agent, own in devices.items():
            refusal = offers[agent].refusal if agent in offers else ""
            enrolled = self._agents.enrolled(agent)
            found[agent] = vehicle_of(enrolled, own, refusal, self._devices, self.roll, self._origin)
        return found

    def _take_origin(self, devices: Mapping[str, tuple[DeviceSeen, ...]]) -> None:
        """Without an origin of the team a map begins where the first vehicle was seen first, and stays."""
        for own in devices.values() if self._origin is None else ():
            place = earth_of(own, self._devices)
            if place is not None:
                self._origin = Origin(place.latitude, place.longitude, place.altitude or 0.0)
                return

    def _seen(self, name: str, host: _Host, now: float) -> HostSeen:
        since = None if host.told is None else max(0.0, now - host.told)
        return HostSeen(
            host=name,
            linked=host.linked,
            trouble=host.trouble,
            age=since,
            up=None if since is None else host.up + (since if host.linked else 0.0),
            restarts=host.restarts,
            ending=host.ending,
            stopped=host.stopped,
            paused=host.paused,
            waits_for=host.waits_for,
            start_held=host.start_held,
            refused=dict(host.refused),
            bundle=host.bundle,
            late=host.late,
            links=dict(host.links),
            away={peer: max(0.0, now - when) for peer, when in host.away.items()},
            lost=dict(host.lost),
            clock=host.wall,
            clock_within=host.within,
            place=self.roll.host_place(name),
        )

    def _offers(self, fresh: Mapping[str, bool]) -> dict[str, OfferSeen]:
        """Of each agent counts what its own host says while that is heard, else what any does."""
        tellers: dict[str, list[str]] = {}
        for name, host in self._hosts.items():
            for agent in host.offers:
                tellers.setdefault(agent, []).append(name)
        found = {}
        for agent, names in tellers.items():
            enrolled = self._agents.enrolled(agent)
            teller = min(names, key=lambda name: (not fresh[name], name != enrolled.host))
            refusal = self._hosts[teller].offers[agent]
            told = {name: self._hosts[name].offers[agent] for name in names if fresh[name]}
            apart = {name: other for name, other in told.items() if bool(other) != bool(refusal)}
            found[agent] = OfferSeen(agent, enrolled.type, teller, refusal, fresh[teller], apart)
        return found

    def _stop(self, now: float, orders: Sequence[OrderSeen]) -> StopSeen:
        stopped = {name: host for name, host in self._hosts.items() if host.stopped}
        standing = {name: host for name, host in stopped.items() if host.linked}
        pressed = next((order for order in orders if order.order == "stop"), None)
        confirmed: list[str] = []
        unconfirmed: dict[str, str] = {}
        before: dict[str, tuple[str, ...]] = {}
        for name, host in stopped.items():
            states = self._devices.of(name)
            safe = [device for device, problem in states.items() if not problem]
            if host.linked:
                confirmed += safe
            else:
                before[name] = tuple(safe)
            # Of who is not heard that counts for as long as a stop is wanted at all.
            if host.linked or standing or pressed is not None:
                unconfirmed |= {
                    device: host.refusals.get(device, why) for device, why in states.items() if why
                }
        unreached = dict(pressed.unreached) if pressed is not None else {}
        asked = pressed.asked if pressed is not None else ()
        for name, host in self._hosts.items() if standing or pressed is not None else ():
            if name not in {*stopped, *unreached, *asked}:
                unreached[name] = _untold(host)
        first = min((standing or stopped).values(), key=lambda host: host.stopped_at or now, default=_Host())
        age = None if first.stopped_at is None else max(0.0, now - first.stopped_at)
        return StopSeen(
            first.stopped,
            first.stopped_by,
            age,
            tuple(standing),
            tuple(confirmed),
            unconfirmed,
            unreached,
            asked,
            before,
        )


def _untold(host: _Host) -> str:
    """Why nobody knows that a host has stopped."""
    if host.linked:
        return "it has not said that it has stopped"
    if host.ending is None:
        return host.trouble
    return f"it has ended: {host.ending}" if host.ending else "it has ended"


def _began(host: _Host, what: object, when: float) -> None:
    """When what a snapshot has shown began, and by whom."""
    if isinstance(what, events.Stopped) and host.stopped and not what.lifted:
        host.stopped_by, host.stopped_at = what.by, when


def _stands(host: _Host, what: object, when: float) -> None:
    """What an event says of its host itself. Of others (portals that began, instructions) nothing stays."""
    match what:
        case events.Stopped(by, reason, lifted):
            host.stopped = "" if lifted else reason or "the emergency stop was pressed"
            host.stopped_by, host.stopped_at = ("", None) if lifted else (by, when)
            host.refusals = {}
        case events.Paused(_, lifted):
            host.paused = not lifted
        case events.Ending(reason):
            host.ending = reason
        case events.Refused(peer, reason):
            host.refused.pop(peer, None)
            if reason:
                host.refused[peer] = reason
        case events.Waits(_, hosts, held):
            host.waits_for, host.start_held = tuple(filter(None, hosts.split(", "))), held
        case events.Linked(peer):
            host.links[peer] = LinkSeen()
            host.away.pop(peer, None)
        case events.Unlinked(peer, lost):
            host.links.pop(peer, None)
            if lost:
                host.away[peer] = when
        case events.Path(peer) if peer in host.links:
            host.links[peer] = _measured(what)
        case events.Offered(agent):
            host.offers[agent] = ""
        case events.Withdrawn(agent, reason):
            host.offers[agent] = reason or "it cannot be called"
        case _:
            pass


def _measured(of: LinkStatus | events.Path) -> LinkSeen:
    return LinkSeen(of.round_trip, of.loss, of.sent, of.received)


def _left_out(host: _Host, what: Words) -> None:
    """What a host has not told nobody ever hears of, whoever looks since when."""
    if isinstance(what, events.Skipped):
        host.lost[what.skipped] += what.count
