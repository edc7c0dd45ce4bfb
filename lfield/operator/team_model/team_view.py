"""The read model of a team: snapshots and events of its hosts in, `TeamState` out. Pure.

Each host has a `HostModel`; this merges them with the agents, devices and orders of the team.

`now` is always the monotonic clock of this computer in seconds, `wall` its Unix time. The data of a host stay
after its link is lost, with their age; a new incarnation starts without them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from lfield.driver.frame import Origin
from lfield.errors import AddressError, LfieldError
from lfield.operator.team_model.agent_tracker import AgentEvent, AgentTracker
from lfield.operator.team_model.command_log import CommandLog
from lfield.operator.team_model.curve_history import CurveHistory
from lfield.operator.team_model.device_tracker import geo_position_of, vehicle_of
from lfield.operator.team_model.host_model import HostModel
from lfield.operator.team_model.log_buffer import LogBuffer, LogEvent, LogRecord
from lfield.operator.team_model.team_contents import TeamContents
from lfield.operator.team_model.team_state import (
    Curve,
    DeviceState,
    HostState,
    OfferState,
    OrderState,
    StopState,
    TeamState,
    TrackUpdate,
    VehicleState,
    agent_of,
)
from lfield.operator.team_model.vehicle_tracks import TeamTracks
from lfield.wire import events
from lfield.wire.events import Event
from lfield.wire.observer_messages import EmergencyStopResult, Status
from lfield.wire.order_messages import OrderKind
from lfield.wire.subscription_messages import EventBatch

#: A host without data.
NO_HOST = HostModel("")


class TeamView:
    """The picture of one team."""

    def __init__(self, inventory: TeamContents) -> None:
        self.inventory = inventory
        self.revision = 0
        self._hosts = {host: self._new_host(host) for host in inventory.hosts}
        self._agents = AgentTracker(inventory)
        self._log, self._curves, self._commands = LogBuffer(), CurveHistory(), CommandLog()
        self._tracks = TeamTracks()
        self._origin = inventory.origin

    # --- in -------------------------------------------------------------------------------------------

    def on_linked(self, name: str) -> None:
        """Record a link to a host."""
        self._host(name).on_linked()
        self._agents.on_linked(name)

    def on_unlinked(self, name: str, reason: str) -> None:
        """Record that a host has no link."""
        self._host(name).on_unlinked(reason)
        self._agents.on_unlinked(name)

    def feed(self, name: str, batch: EventBatch, now: float, wall: float, took: float | None = None) -> None:
        """Handle a batch of a host. `took` is the round trip (s) of a first answer, the uncertainty of the
        host's clock.
        """
        host = self._host_of(name, batch.incarnation)
        host.on_batch(batch, now, wall, took)
        for event in batch.events:
            self._on_event(name, host, event, now)
        if batch.snapshot is not None:
            self._on_snapshot(name, host, batch.snapshot, batch.latest, now)

    def hold_log(self) -> None:
        """Hold the log back until the stored events of the hosts arrive."""
        self._log.hold()

    def start_log(self, before: Iterable[tuple[str, int, Event]], now: float, wall: float) -> None:
        """Add the earlier events: the host, incarnation and event of each."""
        self.revision += 1
        records = []
        for name, incarnation, event in before:
            host, content = self._host(name), event.what
            is_repeated = host.first_after is not None and event.number > host.first_after
            is_same_run = host.incarnation == incarnation
            if isinstance(content, LogEvent) and not (is_repeated and is_same_run):
                when = host.when(event.up, now) if is_same_run else min(now, now - wall + event.at)
                records.append(LogRecord(name, when, event.stamp, content))
                host.on_log_event(content)
        self._log.start(records)

    def on_order(self, order: OrderKind, hosts: Collection[str], now: float) -> int:
        """Record an order that is sent to those hosts; hosts with unknown addresses count as unreached.
        Returns its number.
        """
        self.revision += 1
        number = self._commands.on_order(order, [*self._hosts, *(set(hosts) - set(self._hosts))], now)
        for name in set(self._hosts) - set(hosts):
            self._commands.on_answer(number, name, AddressError(name, "its address is unknown"))
        return number

    def on_answer(self, number: int, name: str, answer: EmergencyStopResult | LfieldError) -> None:
        """Record the answer of a host to an order, or the reason why there is none."""
        host = self._host(name)
        self._commands.on_answer(number, name, answer)
        if isinstance(answer, EmergencyStopResult):
            host.on_answer(answer)

    def tick(self, now: float) -> None:
        """Extend the curves and tracks; called about once a second."""
        self._curves.add(now, self.snapshot(now).vehicles, self._agents.hops_a_minute(now))

    def _host(self, name: str) -> HostModel:
        self.revision += 1
        if name not in self._hosts:
            self._hosts[name] = self._new_host(name)
        return self._hosts[name]

    def _new_host(self, name: str) -> HostModel:
        return HostModel(name, self.inventory.host_place(name), self.inventory.safe_state_flags(name))

    def _host_of(self, name: str, incarnation: int) -> HostModel:
        """A host in one of its incarnations."""
        host = self._host(name)
        if host.incarnation not in (0, incarnation):
            host.on_restarted()
            self._agents.on_restarted(name)
        return host

    def _on_snapshot(self, name: str, host: HostModel, report: Status, latest: int, now: float) -> None:
        host.on_snapshot(report, latest, now)
        self._agents.on_status(name, report.agents, report.coordinators, now)
        self._agents.on_startable(name, report.startable, now)

    def _on_event(self, name: str, host: HostModel, event: Event, now: float) -> None:
        when, content = host.when(event.up, now), event.what
        is_past = event.number <= host.past and not isinstance(content, events.TelemetryEvent)
        if isinstance(content, AgentEvent):
            self._agents.on_event(name, content, when, is_past=is_past)
        elif isinstance(content, LogEvent):
            self._log.add(LogRecord(name, when, event.stamp, content))
            host.on_log_event(content)
        elif is_past:
            host.on_past_event(content, when)
        elif isinstance(content, events.PortalCallEnded):
            self._agents.on_served(name, content.resource)
        else:
            self._countermanded(content, when)
            host.on_event(content, when)

    def _countermanded(self, event: object, when: float) -> None:
        match event:
            case events.EmergencyStopChanged(_, _, lifted):
                self._commands.on_order_event("lift" if lifted else "stop", when)
            case events.PauseChanged(_, lifted, False):
                self._commands.on_order_event("resume" if lifted else "pause", when)
            case _:
                pass

    # --- out ------------------------------------------------------------------------------------------

    def curves(self, now: float) -> tuple[Curve, ...]:
        """The curves of the plots."""
        return self._curves.snapshot(now)

    def tracks(self, after: int) -> TrackUpdate:
        """The tracks of the vehicles after a point number, as of the last snapshot."""
        return self._tracks.since(after)

    def snapshot(self, now: float) -> TeamState:
        """The state of the team at that time."""
        hosts = {name: host.state(now) for name, host in self._hosts.items()}
        fresh = {name: host.linked for name, host in hosts.items()}
        devices, offers = self._devices_by_agent(hosts), self._offers(fresh)
        unsafe = {
            name: reason
            for host in self._hosts.values()
            for name, reason in host.devices.problems.items()
            if reason
        }
        orders = self._commands.snapshot(now, hosts, unsafe)
        return TeamState(
            team=self.inventory.team,
            revision=self.revision,
            hosts=hosts,
            vehicles=self._vehicles(devices, offers),
            agents=self._agents.snapshot(now, fresh),
            offers=offers,
            stop=self._stop(now, orders),
            log=self._log.snapshot(now),
            orders=orders,
        )

    def _devices_by_agent(self, hosts: Mapping[str, HostState]) -> dict[str, tuple[DeviceState, ...]]:
        """The devices by agent; of a device that several hosts name, the state on its agent's host counts."""
        found: dict[str, dict[str, DeviceState]] = {agent_of(name): {} for name in self.inventory.devices}
        for name, host in hosts.items():
            for device in host.devices.values():
                own, enrolled = found.setdefault(device.agent, {}), self.inventory.agents.get(device.agent)
                if device.name not in own or (enrolled is not None and enrolled.host == name):
                    own[device.name] = device
        return {agent: tuple(own.values()) for agent, own in found.items() if own}

    def _vehicles(
        self, devices: Mapping[str, tuple[DeviceState, ...]], offers: Mapping[str, OfferState]
    ) -> dict[str, VehicleState]:
        self._set_origin(devices)
        found = {}
        for agent, own in devices.items():
            refusal = offers[agent].refusal if agent in offers else ""
            enrolled = self._agents.entry(agent)
            found[agent] = vehicle_of(enrolled, own, refusal, self.inventory, self._origin)
        self._tracks.add(found.values())
        return found

    def _set_origin(self, devices: Mapping[str, tuple[DeviceState, ...]]) -> None:
        """Set the origin of a map without one of the team: the first position of the first vehicle; it
        stays.
        """
        for own in devices.values() if self._origin is None else ():
            place = geo_position_of(own, self.inventory)
            if place is not None:
                self._origin = Origin(place.latitude, place.longitude, place.altitude or 0.0)
                return

    def _offers(self, fresh: Mapping[str, bool]) -> dict[str, OfferState]:
        """The offers by agent: as reported by its own host while that is linked, else by any host."""
        tellers: dict[str, list[str]] = {}
        for name, host in self._hosts.items():
            for agent in host.offers:
                tellers.setdefault(agent, []).append(name)
        found = {}
        for agent, names in tellers.items():
            enrolled = self._agents.entry(agent)
            reporter = min(names, key=lambda name: (not fresh[name], name != enrolled.host))
            refusal = self._hosts[reporter].offers[agent]
            reported = {name: self._hosts[name].offers[agent] for name in names if fresh[name]}
            apart = {name: other for name, other in reported.items() if bool(other) != bool(refusal)}
            found[agent] = OfferState(agent, enrolled.type, reporter, refusal, fresh[reporter], apart)
        return found

    def _stop(self, now: float, orders: Sequence[OrderState]) -> StopState:
        stopped = {name: host for name, host in self._hosts.items() if host.known.stopped}
        linked = {name: host for name, host in stopped.items() if host.known.linked}
        pressed = next((order for order in orders if order.order == "stop"), None)
        confirmed: list[str] = []
        unconfirmed: dict[str, str] = {}
        before: dict[str, tuple[str, ...]] = {}
        for name, host in stopped.items():
            states = host.devices.problems
            safe = [device for device, problem in states.items() if not problem]
            if host.known.linked:
                confirmed += safe
            else:
                before[name] = tuple(safe)
            # The last report of an unreachable host counts while any stop is active.
            if host.known.linked or linked or pressed is not None:
                unconfirmed |= {
                    device: host.refusals.get(device, reason) for device, reason in states.items() if reason
                }
        unreached = dict(pressed.unreached) if pressed is not None else {}
        pending = pressed.pending if pressed is not None else ()
        for name, host in self._hosts.items() if linked or pressed is not None else ():
            if name not in {*stopped, *unreached, *pending}:
                unreached[name] = _unknown_why(host.known)
        first = min((linked or stopped).values(), key=lambda host: host.stopped_at or now, default=NO_HOST)
        age = None if first.stopped_at is None else max(0.0, now - first.stopped_at)
        return StopState(
            first.known.stopped,
            first.stopped_by,
            age,
            tuple(linked),
            tuple(confirmed),
            unconfirmed,
            unreached,
            pending,
            before,
        )


def _unknown_why(host: HostState) -> str:
    """The reason why the stop of a host is not confirmed."""
    if host.linked:
        return "the host has not confirmed the stop"
    if host.end_reason is None:
        return host.problem
    return f"the host has ended: {host.end_reason}" if host.end_reason else "the host has ended"
