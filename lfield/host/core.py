"""The core of one host: it owns the parts, dispatches messages and events, and runs the machine. Pure.

Inputs in, effects out. It has no event loop, socket, process, disk, clock or RNG of its own: the shell
(host.py) lets each input (inputs.py) enter, calls `run`, and executes the effects that
`drain_effects` returns. A simulator and a replay do the same. Only this module creates the parts.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, get_args

from msgspec import structs

from lfield.errors import DeviceError
from lfield.host.context import (
    EventHandler,
    HostContext,
    HostEvent,
    LinkClosed,
    LinkOpened,
    Part,
    WriteFailed,
)
from lfield.host.effects import WAKE_WAITERS, Effect, OpenLink
from lfield.host.events.migration_events import MigrationEvents
from lfield.host.location.call_watch import CallWatch
from lfield.host.location.locator import Locator
from lfield.host.migration.delayed_acks import DelayedAcks
from lfield.host.migration.init_barrier import InitBarrier
from lfield.host.offer_queries import CapabilityQueries
from lfield.host.order_history.executed_orders import ExecutedOrders
from lfield.host.person_calls.person_calls import PersonCalls
from lfield.host.sequencing.sequencing_service import SequencingService
from lfield.host.team import operator_commands
from lfield.host.team.coordinators import Coordinators
from lfield.host.team.device_commands import DeviceCommands
from lfield.host.team.host_services import HostServices
from lfield.host.team.leases import TeamLeases
from lfield.host.team.pending_call_store import PendingCallStore
from lfield.host.team.reachability import Reachability
from lfield.host.team.reservation_service import ReservationService
from lfield.host.team.startup import Startup
from lfield.host.team_directory import TeamDirectory
from lfield.manifest import DeviceValue
from lfield.replication.lease.quorum_members import FencingTokens
from lfield.replication.locate.outcomes import CoordinatorOutcome
from lfield.replication.membership.membership import Membership
from lfield.replication.transfer import effects as mobile
from lfield.replication.transfer.core import Mobility
from lfield.replication.transfer.query_relay import QueryRelay
from lfield.text import log_messages
from lfield.vm.agent import Agent, MachineTeam
from lfield.vm.hooks import VmHooks
from lfield.vm.machine import Machine
from lfield.vm.waits.operator_input import MAX_LINE
from lfield.wire.coordinator_messages import Terminated, Transfer, TransferAccepted, TransferRefused
from lfield.wire.messages import Control, Hello, RelayedMessage
from lfield.wire.observer_messages import RecoverRequest, RecoverResponse


class Timed(Protocol):
    """A part with a time at which it has work."""

    due: float | None
    """In seconds of the host's clock; None for never."""


class HostCore:
    """One host of a mission, without I/O."""

    def __init__(self, context: HostContext) -> None:
        self.context, self.mission, self.team = context, context.mission, context.team
        self.name = context.name
        self.own_number, self.incarnation = context.own_number, context.incarnation
        self.recorder = context.recorder
        self._clock, self._effects, self._log = context.clock, context.effects, context.log
        mission, records = context.mission, context.records
        self.orders = ExecutedOrders(
            context.random_bytes or context.rng.randbytes, ExecutedOrders.restored_orders(records)
        )
        #: Answers the queries of the machine; it looks the parts up at each query.
        self.services = HostServices(context, self)
        view = MachineTeam(self.team.members, self.own_number, self.incarnation, mission.fenced)
        rules, limit, fresh = mission.calls, context.run_limit, context.fresh_time
        hooks = VmHooks(rules=rules, liveness=self.services, run_limit=limit, fresh_time=fresh)
        self.machine = machine = Machine(
            mission.program, view, self.services, context.clock, context.rng, context.engines, hooks
        )
        #: Seconds for which programs have run here: not charged to the peer whose message triggered them.
        self.run_seconds = 0.0
        self._stopwatch = context.stopwatch or context.clock.monotonic
        self.membership = membership = _membership(context)
        fences = FencingTokens(
            {k: v for k, v in context.restored_fences.items() if k in context.leased_agents}
        )
        self._migrations = MigrationEvents(context.recorder, machine, self.name, self.team)
        self.mobility = mobility = _mobility(context)
        relay = _relay(context, membership, mobility)
        acks = DelayedAcks(relay.send, self._clock.monotonic, context.recorder.hybrid_clock)
        self.coordinators = coordinators = Coordinators(
            context, machine, mobility, relay, acks, fences, self._migrations
        )
        self.leases = TeamLeases(context, self.coordinators, machine, fences)
        self.pending_calls = PendingCallStore(context, self.coordinators, self.leases, machine)
        links = membership.is_linked
        self.reservations = ReservationService(context, coordinators, self.leases, machine, links)
        self.person_calls = PersonCalls(context, coordinators, self.leases, self.reservations, machine)
        self.directory = TeamDirectory(context, machine, self.reservations.holder_of, membership)
        self.offers = CapabilityQueries(self.directory, mission)
        self._inits = InitBarrier(machine.opening, context.log)
        self.commands = DeviceCommands(context, machine, self.leases, membership, mobility)
        self.sequencing = SequencingService(context, self.coordinators, self.leases, machine)
        self.locator = Locator(context, self.coordinators, self.leases, self.commands)
        self.reachability = Reachability(context, membership, mobility)
        self.call_watch = CallWatch(context, machine, self.reachability)
        #: The start of the coordinators of this host, and the conditions for a new start.
        self.startup = Startup(context, self.coordinators, self.leases, membership)
        #: The parts, in the order in which they receive events and are polled.
        self._parts: list[Part | QueryRelay[Effect]] = [
            acks, self.directory, coordinators, self.reachability, relay, self.leases, self.startup,
            self.commands, self.pending_calls, self.reservations, self.person_calls, self.locator,
            self.call_watch, self.sequencing,
        ]  # fmt: skip
        self._handlers = {kind: handler for part in self._parts for kind, handler in part.handles.items()}
        self._observers: dict[type[HostEvent], list[EventHandler]] = {
            kind: [part.observes[kind] for part in self._parts if kind in part.observes]
            for kind in get_args(HostEvent)
        }
        #: The parts with due times.
        self._timed: list[Timed] = [*self._parts, self._inits, self.coordinators.write_ahead]

    def drain_effects(self) -> list[Effect]:
        """The pending effects, in order; each is returned once."""
        effects = self._effects.copy()
        self._effects.clear()
        if self.context.journal_id:
            effects += self.coordinators.next_batches()
        return effects

    def hello(self) -> Hello:
        states = self.coordinators.handshake_states()
        stamp = self.recorder.hybrid_clock.tick(self.recorder.now())
        return structs.replace(
            self.context.greeting, coordinators=states, epochs=self.orders.epochs, stamp=stamp
        )

    def require_link(self, host: str) -> None:
        """Request a link to this host, if there is none."""
        if not self.membership.is_linked(host):
            self._effects.append(OpenLink(host))

    def _publish(self, event: HostEvent) -> None:
        for observer in self._observers[type(event)]:
            observer(event)

    def run(self) -> float | None:
        """Run the parts that are due, then the machine.

        Call `run` after every event, and when it is due. Returns the seconds until the next call (0: at
        once), None if the next call is needed only after an event.
        """
        now, recorder = self._clock.monotonic(), self.recorder
        if now >= recorder.due:
            recorder.refill(now)
        for part in self._parts:
            if part.is_polled or (part.due is not None and now >= part.due):
                part.on_tick(now)
        reservations, waits = self.reservations, self.coordinators.is_halted or self.coordinators.paused
        if reservations.is_polled:
            # Coordinators resumed until now run in this turn.
            reservations.poll_resumed()
        pause = None
        if not waits:
            start = self._stopwatch()
            pause = self.machine.run()
            self.run_seconds += self._stopwatch() - start
        if recorder.detailed:
            recorder.drain()
        if self.machine.opening or self._inits.is_polled:
            self._inits.on_tick(now)
        if reservations.is_polled:
            # A portal that has ended may free a resource that a coordinator waits to reserve.
            reservations.on_tick(self._clock.monotonic())
            if reservations.poll_resumed():
                return 0.0
        for timed in self._timed:
            if (due := timed.due) is not None and (pause is None or due - now < pause):
                pause = max(0.0, due - now)
        return pause

    # --- life cycle -----------------------------------------------------------------------------------

    def start_resources(self, *, first: bool = False) -> None:
        """The devices are open: start the resources, and admit waiting arrivals; `first` as below."""
        for member in self.team.members_on(self.own_number):
            if member.kind == "resource":
                self.recorder.on_agent_started(member.id, 0)
                self.machine.start(member, self.mission.bindings.limits(member.id), 0)
        self.pending_calls.restore()
        self.reservations.restore()
        self.directory.open()
        self.coordinators.on_resources_started()
        self.leases.start(first=first)

    def start_coordinators(self, *, first: bool = False) -> None:
        """The other hosts had time to report: resume the coordinators in the journal, and start the
        coordinators of this host that exist on no host.

        `first`: an operator asserts that there was no earlier start. Otherwise a host without a record waits
        for the reports of all other hosts.
        """
        self.leases.on_restored()
        before = set(self.machine.agents)
        self.coordinators.resume_from_journal()
        for name in self.machine.agents.keys() - before:
            self.recorder.on_agent_started(name, self.machine.agents[name].generation, is_restored=True)
        self.pending_calls.on_restored()
        for known in self.mobility.known_states():
            # A fenced copy may not run anywhere.
            if known.state in ("PREPARED", "IN DOUBT") and known.where:
                self._migrations.restore_in_flight(known)
                self.require_link(known.where)
        self.sequencing.open(first=first)
        self.startup.open(first=first)

    def stop_agents(self) -> None:
        """The host stops: no agent runs or is admitted any more. Transfers, events and status continue."""
        self.coordinators.suspend_all()
        self.person_calls.on_halted()
        self.startup.on_halted()

    @property
    def has_coordinators(self) -> bool:
        """Whether coordinators start here, or were here in the previous incarnation."""
        own = self.startup.own_agents or self.sequencing.own_agents
        return bool(own or self.coordinators.recovery.copies)

    def wait_reason(self, agent: Agent) -> str:
        """A short text about what a coordinator waits for besides its own work; '' if it does not wait."""
        if not agent.frozen:
            first = "waits for the first of its calls" if agent.waits_for_any else ""
            return first or self._inits.wait_reason(agent)
        if self.leases.is_waiting(agent):
            return "waits for a majority"
        reserves = self.reservations.wait_reason(agent) or self.sequencing.wait_reason(agent)
        return reserves or operator_commands.wait_reason(
            self.coordinators, self.machine, self.team.hosts, agent
        )

    def on_write_failed(self, reason: str) -> None:
        """Writing the journal failed: the write is retried."""
        self._publish(WriteFailed(reason))

    def on_disk_space(self, problem: str) -> None:
        """Announce the reason why the journal should admit nothing more, or '', to the other hosts."""
        accepted = log_messages.MIGRATIONS_ACCEPTED.line(host=self.name)
        rejected = log_messages.MIGRATIONS_REJECTED.line(host=self.name, reason=problem)
        self._log(rejected if problem else accepted)
        self.coordinators.set_space_problem(problem)
        self._send_backpressure()

    def _send_backpressure(self) -> None:
        self._effects += [mobile.Send(host, self.coordinators.backpressure) for host in self.membership.links]

    def set_paused(self, *, on: bool, order: bytes = b"") -> None:
        """An operator pauses the mission on this host, or resumes it."""
        operator_commands.set_paused(self.coordinators, self.machine, on=on, order=order)
        self._on_pause_changed()

    def set_ballot_hold(self, ballot: bytes) -> None:
        """The service of this robot holds the mission until the result of a ballot is known; b"" ends the
        hold.
        """
        operator_commands.set_ballot_hold(self.coordinators, self.machine, ballot)
        self._on_pause_changed()

    def _on_pause_changed(self) -> None:
        self.reservations.postpone()
        if self.coordinators.paused:
            self.person_calls.abandon_waiting("the mission was paused")
        self._send_backpressure()
        self.startup.check()

    def set_emergency_stop(self, reason: str, order: bytes = b"") -> None:
        """An operator has sent an emergency stop with that reason, or has lifted it ('')."""
        operator_commands.set_emergency_stop(self.coordinators, reason, order)

    def on_durable(self, number: int) -> None:
        """All records up to those of that batch are on disk."""
        self.coordinators.on_durable(number)

    def on_host_exited(self, host: str) -> None:
        """A host of this team has ended permanently, as reported by the process that started it."""
        if host in self.team.hosts and host != self.name:
            self.membership.ended.add(host)
            self.startup.on_host_exited(host)
            self.sequencing.on_host_exited(host)
            self._effects.append(WAKE_WAITERS)

    def needed_hosts(self) -> set[str]:
        """The hosts that need links with this host now: neighbours, and hosts that this host waits for."""
        waited = self.mobility.needed_hosts() | self.leases.needed_hosts | self.reservations.needed_hosts
        waited.update(*(p.needed_hosts for p in (self.startup, self.call_watch, self.sequencing)))
        waited.update(self.membership.overlay_links(self._clock.monotonic()))
        return waited - {self.name}

    def on_link_refused(self, host: str, reason: str, bundle: bytes) -> None:
        """No link with a host can be made, for that reason; '' when a link is possible again."""
        self.recorder.on_link_refused(host, reason)
        self.startup.on_refused(host, reason, bundle)

    def forget(self, agent: str) -> list[int]:
        """An operator declares this coordinator lost; returns the starts of it that end here."""
        return operator_commands.declare_lost(self.coordinators, agent)

    def recover(self, request: RecoverRequest) -> RecoverResponse:
        """An operator declares the holder of a coordinator permanently lost: resume it on this host."""
        return operator_commands.recover(self.coordinators, self.leases, self.name, self.own_number, request)

    def broadcast_outcomes(self, found: Iterable[CoordinatorOutcome]) -> None:
        """Before this host stops: send all terminations, and the outcomes found, to every reachable host."""
        self.coordinators.apply_effects(self.mobility.broadcast_outcomes(found))

    # --- events of links ------------------------------------------------------------------------------

    def on_linked(self, hello: Hello) -> None:
        """A link with a host opened."""
        self.recorder.hybrid_clock.merge(hello.host, hello.stamp, self._clock.monotonic())
        restarted = self.reachability.on_link_opened(hello.host, hello.incarnation)
        if restarted or hello.host in self.membership.neighbours:
            self._log(log_messages.LINKED.line(host=hello.host, restarted=restarted))
        self.recorder.on_linked(hello.host, restarted=restarted)
        self._publish(LinkOpened(hello))
        self._effects.append(WAKE_WAITERS)

    def on_unlinked(self, host: str, *, quietly: bool = False) -> None:
        """The last link with a host closed; `quietly`: this host did not need it."""
        self.recorder.on_unlinked(host, lost=not quietly)
        if not quietly and not self.coordinators.is_halted:
            self._log(log_messages.LINK_LOST.line(host=host))
        self.reachability.on_link_closed(host)
        self._publish(LinkClosed(host))
        self._effects.append(WAKE_WAITERS)

    def on_transfer(self, host: str, header: Transfer, block: memoryview) -> None:
        """A coordinator arrived: the coordinator runs before its sender gets an answer."""
        transit = self.reachability.transit_time(host) if self.machine.program.has_limits else 0.0
        self.coordinators.on_transfer(host, header, block, transit)

    def on_oversize(self, host: str, header: Transfer, size: int) -> None:
        """A coordinator with an oversized block arrived; the block was not read."""
        self.coordinators.apply_effects(self.mobility.on_oversize(host, header, size))

    def on_message(self, host: str, message: Control) -> None:
        """A message from a host: pass it to the part that handles its type."""
        answer = message.message if isinstance(message, RelayedMessage) else message
        if isinstance(answer, TransferAccepted | TransferRefused | Terminated):
            self.recorder.hybrid_clock.merge(host, answer.stamp, self._clock.monotonic())
        if (handler := self._handlers.get(type(message))) is not None:
            handler(host, message)

    def on_line_entered(self, text: str, agent: str = "") -> str:
        """A line of the operator's input, for an agent or for the next one that reads.

        Returns why no agent gets it, '' if one does."""
        if len(text) > MAX_LINE:
            self._log(log_messages.INPUT_CUT.line(host=self.name, length=MAX_LINE))
        problem = self.machine.operator_input.enter(text, is_kept=not agent, agent=agent)
        if problem:
            self._log(log_messages.INPUT_DROPPED.line(host=self.name, reason=problem))
        return problem

    def on_device_answer(self, number: int, value: DeviceValue | DeviceError) -> None:
        """The result of the device call of that number."""
        self.commands.on_device_answer(number, value)


def _membership(context: HostContext) -> Membership:
    team, own_number, now = context.team, context.own_number, context.clock.monotonic()
    return Membership(
        team.hosts, team.numbers, own_number, context.incarnation, now, context.overlay, context.environment
    )


def _mobility(context: HostContext) -> Mobility:
    agents = [member.id for member in context.team.coordinators]
    return Mobility(context.greeting, context.team.hosts, agents, context.unreachable_after)


def _relay(context: HostContext, membership: Membership, mobility: Mobility) -> QueryRelay[Effect]:
    identity = context.team.hosts, context.own_number, context.incarnation
    return QueryRelay[Effect](*identity, context.clock, context.effects.append, membership, mobility)
