"""Reservations of one host, between its machine, its journal and the other hosts (`reservations` decides).

The reservations of its own coordinators are read from their blocks (`HeldReservations.of_coordinator`). They
are renewed here or by messages, as long as the coordinators are here or wait to leave. Sans-IO.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import get_args

from lfield.capability.directory.directory_delta import ReservedBy
from lfield.host.context import HostContext, LinkOpened, Part, WriteFailed
from lfield.host.team.part_interfaces import CoordinatorOperations, LeaseRules
from lfield.host.team.reservations import (
    RESERVED,
    DenyWaiter,
    HeldReservation,
    PersistHolder,
    ReservationDenied,
    Reservations,
    RetryWaiter,
    StartKey,
)
from lfield.journal.records import ReservationRecord
from lfield.replication.transfer.effects import Send
from lfield.replication.transfer.transfer_sender import LIMIT, UNREACHABLE
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import Trap
from lfield.vm.machine import Machine
from lfield.wire.fields import truncate
from lfield.wire.reservation_messages import ReleaseReservation, RenewReservation, ReservationMessage


class ReservationService(Part):
    """The reservations of one host's resources, and the reservations of its coordinators on other hosts.

    `is_linked` returns whether there is a link with a host.
    """

    def __init__(
        self,
        context: HostContext,
        team: CoordinatorOperations,
        leases: LeaseRules,
        machine: Machine,
        is_linked: Callable[[str], bool],
    ) -> None:
        mission, hello, records = context.mission, context.greeting, context.records
        self._hello, self._hosts, self._has_journal = hello, mission.team.hosts, context.has_journal
        self._team, self._leases, self._machine = team, leases, machine
        self._clock, self._out, self._linked = context.clock, context.effects.append, is_linked
        self._own_number = context.own_number
        self._coordinators = [member.id for member in mission.team.coordinators]
        self._resources = {m.id for m in mission.team.members_on(self._own_number) if m.kind == "resource"}
        bindings = mission.bindings
        self._lease = bindings.reservations.lease
        first = hello.incarnation % (1 << 30) << 20
        self._reservations = Reservations(first, self._lease, bindings.reserved_wait, self._busy)
        self._records = [record for record in records if isinstance(record, ReservationRecord)]
        #: The coordinators that are frozen here for a resource.
        self._waiting: dict[StartKey, Agent] = {}
        #: The calls of persons that wait for a resource, and the calls that may try again.
        self._waiting_persons: set[StartKey] = set()
        self._retried_persons: list[StartKey] = []
        #: The time when the reservations of each coordinator here were last renewed.
        self._renewed: dict[str, tuple[Agent, float]] = {}
        #: Whether a coordinator was resumed since the last `poll_resumed`.
        self._was_resumed = False
        #: Without a `reserve` in the program there is no work in any turn.
        self.is_polled = machine.program.has_reserves
        self.handles = dict.fromkeys(get_args(ReservationMessage), self._on_message)
        self.observes = {
            LinkOpened: self._on_link_opened,
            WriteFailed: self._on_write_failed,
        }

    def restore(self) -> None:
        """The resources are started: a holder before the restart keeps its reservation for one lease."""
        now = self._clock.monotonic()
        for record in self._records:
            holder = (record.agent, record.generation) if record.agent else None
            self._reservations.restore(record.resource, record.number, holder, now)
        self._apply_effects()

    # --- the machine asks -----------------------------------------------------------------------------

    def acquire(self, agent: Agent, resource: TeamMember, *, nested: bool) -> int:
        """See `HostInterface.acquire_reservation`."""
        found = self._machine.agents.get(resource.id)
        if found is None or found.ended:
            state = f"it died of {found.report.splitlines()[0]}" if found else "its host does not run it"
            raise Trap(UNREACHABLE, f"{resource.id} is gone: {state}", resource.id)
        if self._team.write_problem:
            reason = f"{self._hello.host} cannot write its journal: {self._team.write_problem}"
            raise Trap(LIMIT, reason, resource.id)
        if not self._leases.may_start_call(agent):
            # The coordinator waits for the lease first, or is fenced and has stopped: it is not in the queue.
            return 0
        start = agent.id, agent.generation
        self._waiting[start] = agent
        try:
            number = self._reservations.acquire(start, resource.id, self._clock.monotonic(), nested=nested)
        except ReservationDenied as refused:
            del self._waiting[start]
            raise Trap(refused.kind, str(refused), resource.id) from None
        finally:
            self._apply_effects()
        if number:
            self._waiting.pop(start, None)
        return number

    def release_all(self, agent: Agent, held: Sequence[tuple[TeamMember, int]]) -> None:
        """See `HostInterface.release_reservations`."""
        for resource, number in held:
            host = self._hosts[resource.host]
            if resource.host == self._own_number:
                self._reservations.release(resource.id, number, self._clock.monotonic())
            elif self._linked(host):
                self._out(Send(host, ReleaseReservation(resource.id, number)))
        self._apply_effects()

    def may_serve(self, agent: Agent, resource: TeamMember, number: int) -> bool:
        """See `HostInterface.may_serve`."""
        if not self._leases.may_start_call(agent):
            return False
        start = agent.id, agent.generation
        nested = not number and bool(self._machine.held_reservations.of_coordinator(agent))
        try:
            serves = self._reservations.may_serve(
                start, resource.id, number, self._clock.monotonic(), nested=nested
            )
        except ReservationDenied as refused:
            raise Trap(refused.kind, str(refused), resource.id) from None
        finally:
            self._apply_effects()
        if not serves:
            self._waiting[start] = agent
        return serves

    def may_serve_person(self, start: StartKey, resource: str) -> bool:
        """See `ReservationRules.may_serve_person`."""
        try:
            serves = self._reservations.may_serve(start, resource, 0, self._clock.monotonic())
        except ReservationDenied as refused:
            raise Trap(refused.kind, str(refused), resource) from None
        finally:
            self._apply_effects()
        if not serves:
            self._waiting_persons.add(start)
        return serves

    def drain_retried_persons(self) -> list[StartKey]:
        """See `ReservationRules.drain_retried_persons`."""
        retried, self._retried_persons = self._retried_persons, []
        return retried

    def abandon_person(self, start: StartKey) -> None:
        """See `ReservationRules.abandon_person`."""
        self._waiting_persons.discard(start)
        self._reservations.abandon_wait(start, self._clock.monotonic())
        self._apply_effects()

    def abandon_wait(self, agent: Agent) -> bool:
        """Cancel a coordinator's wait; returns whether it waited."""
        start = agent.id, agent.generation
        self._waiting.pop(start, None)
        waited = self._reservations.abandon_wait(start, self._clock.monotonic())
        self._apply_effects()
        return waited

    def wait_reason(self, agent: Agent) -> str:
        """A short text about the resource that a frozen coordinator waits for; '' for none."""
        start = agent.id, agent.generation
        resource = self._reservations.waits_for(start) if self._waiting.get(start) is agent else ""
        if not resource:
            return ""
        held = self._reservations.holder_of(resource)
        return f"waits for {resource}" + (f", which {held.holder[0]} has reserved" if held else "")

    def _busy(self, resource: str, agent: str) -> bool:
        found = self._machine.agents.get(resource)
        return found is not None and self._machine.served_calls.has_others(found, agent)

    # --- events ---------------------------------------------------------------------------------------

    def _on_message(self, host: str, message: ReservationMessage) -> None:
        """Another host reports on the holder of a resource of this host."""
        now = self._clock.monotonic()
        if self._team.paused:
            # Late renewals, from a host that did not know whether the holder had left, cause no loss.
            self._reservations.postpone(now)
        match message:
            case RenewReservation() if message.resource in self._resources:
                start = message.agent, message.generation
                self._reservations.renew(start, message.resource, message.number, now)
            case ReleaseReservation() if message.resource in self._resources:
                self._reservations.release(message.resource, message.number, now)
        self._apply_effects()

    def _on_link_opened(self, event: LinkOpened) -> None:
        """The host may have received no renewals for a while."""
        self._renewed.clear()

    @property
    def needed_hosts(self) -> set[str]:
        """The hosts that need renewals from this one."""
        if not self.is_polled:
            return set()
        reservations = (
            entry
            for agent in self._local_coordinators()
            for entry in self._machine.held_reservations.of_coordinator(agent)
        )
        return {self._hosts[resource.host] for resource, _ in reservations}

    def _on_durable(self, resource: str, number: int) -> None:
        """The record of a holder is on disk."""
        self._reservations.on_durable(resource, number, self._clock.monotonic())
        self._apply_effects()

    def _on_write_failed(self, event: WriteFailed) -> None:
        """A coordinator that waits for its record is denied the resource."""
        for resource, start in self._reservations.unwritten:
            agent = self._waiting.get(start)
            self._reservations.abandon_wait(start, self._clock.monotonic())
            if agent is not None and self._is_frozen(agent):
                reason = f"{self._hello.host} cannot write its journal: {event.reason}"
                self._machine.resume(agent, LIMIT, reason, resource)
        self._apply_effects()

    def postpone(self) -> None:
        """The host was stalled: restart all time-outs of waiting coordinators."""
        self._reservations.postpone(self._clock.monotonic())

    # --- time -----------------------------------------------------------------------------------------

    def _update_due(self) -> None:
        dues = [when + self._lease / 3 for _, when in self._renewed.values()]
        due = None if self._team.paused else self._reservations.due
        self.due = min([*dues, *([] if due is None else [due])], default=None)

    def on_tick(self, now: float) -> None:
        """Process time-outs and events; called in every turn, before and after agents run."""
        if self._team.is_halted:
            self.due = None
            return
        agents = self._machine.agents
        self._waiting = {
            start: waiting for start, waiting in self._waiting.items() if agents.get(waiting.id) is waiting
        }
        self._renew(now)
        for start in sorted(self._reservations.concerned - self._waiting_persons):
            reason = self._leases.end_reason(*start)
            # Before the record is on disk, a restart of this host would return the reservation to this start.
            if reason and not self._team.write_ahead.is_pending_durable(start[0]):
                self._reservations.on_start_ended(start, reason, now)
        if not self._team.paused:
            self._reservations.tick(now)
        self._apply_effects()
        self._update_due()

    def poll_resumed(self) -> bool:
        """Whether a coordinator was resumed since the last call."""
        resumed, self._was_resumed = self._was_resumed, False
        return resumed

    def _local_coordinators(self) -> list[Agent]:
        """The coordinators that are here as far as is known; a coordinator in doubt may have moved on."""
        found = (self._machine.agents.get(name) for name in self._coordinators)
        return [agent for agent in found if agent is not None and not agent.ended and self._holds_any(agent)]

    def _holds_any(self, agent: Agent) -> bool:
        return not (agent.frozen and self._team.mobility.is_in_doubt(agent.id, agent.generation))

    def _renew(self, now: float) -> None:
        before, self._renewed = self._renewed, {}
        for agent in self._local_coordinators():
            last, when = before.get(agent.id, (None, 0.0))
            if last is agent and now < when + self._lease / 3:
                self._renewed[agent.id] = agent, when
                continue
            self._renewed[agent.id] = agent, now
            for resource, number in self._machine.held_reservations.of_coordinator(agent):
                self._renew_one(agent, resource, number, now)

    def _renew_one(self, agent: Agent, resource: TeamMember, number: int, now: float) -> None:
        host = self._hosts[resource.host]
        if resource.host == self._own_number:
            self._reservations.renew((agent.id, agent.generation), resource.id, number, now)
        elif self._linked(host):
            self._out(Send(host, RenewReservation(resource.id, number, agent.id, agent.generation)))

    # --- status ---------------------------------------------------------------------------------------

    @property
    def held(self) -> list[HeldReservation]:
        """The reservations of this host's resources."""
        return list(self._reservations.held.values())

    def holder_of(self, resource: str) -> ReservedBy | None:
        """The holder of a resource of this host, for the directory."""
        held = self._reservations.holder_of(resource)
        return None if held is None else ReservedBy(held.holder[0], held.held_since)

    # --- effects --------------------------------------------------------------------------------------

    def _apply_effects(self) -> None:
        while effects := self._reservations.drain_effects():
            for effect in effects:
                match effect:
                    case PersistHolder():
                        self._write(effect)
                    case RetryWaiter():
                        self._retry(effect.start)
                    case DenyWaiter():
                        self._deny(effect)
        for resource in self._reservations.known:
            if (found := self._machine.agents.get(resource)) is not None:
                found.mark_reserved(is_reserved=self._reservations.is_contended(resource))

    def _write(self, effect: PersistHolder) -> None:
        if self._has_journal:
            agent, generation = effect.holder or ("", 0)
            record = ReservationRecord(effect.resource, effect.number, agent, generation)
            batch = self._team.write_ahead.add_record(record, self._clock.monotonic(), is_lazy=effect.is_lazy)
            if effect.holder is not None:
                action = partial(self._on_durable, effect.resource, effect.number)
                self._team.write_ahead.when_durable(batch, action)
        elif effect.holder is not None:
            self._reservations.on_durable(effect.resource, effect.number, self._clock.monotonic())

    def _retry(self, start: StartKey) -> None:
        if start in self._waiting_persons:
            self._waiting_persons.discard(start)
            self._retried_persons.append(start)
            self._was_resumed = True
            return
        agent = self._waiting.pop(start, None)
        if agent is not None and self._is_frozen(agent):
            self._machine.unfreeze(agent)
            self._was_resumed = True

    def _deny(self, effect: DenyWaiter) -> None:
        agent = self._waiting.pop(effect.start, None)
        if agent is not None and self._is_frozen(agent):
            self._machine.resume(agent, RESERVED, truncate(effect.message), effect.resource)
            self._was_resumed = True

    def _is_frozen(self, agent: Agent) -> bool:
        """Whether a coordinator still waits here; False if it was resumed and waits to leave."""
        held = self._machine.agents.get(agent.id) is agent and agent.frozen and not agent.ended
        return held and not self._team.is_departing(agent)
