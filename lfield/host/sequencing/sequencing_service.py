"""Starts and stops the coordinators of this host that other coordinators may start (decision 105). Sans-IO.

The coordinator that asks is on this host, the home of the other coordinator. It is suspended at its
instruction, and its block is on disk. A start and an ordered end are on disk before it continues. A request
for a start has a number, so that it has one effect, although its instruction may run again after a restart of
this host.
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Literal, NamedTuple, NoReturn

from lfield.host.context import HostContext, LinkClosed, LinkOpened, Part
from lfield.host.sequencing.startable_runs import StartableRuns, is_of_run
from lfield.host.team.part_interfaces import CoordinatorOperations, LeaseRules
from lfield.journal.records import SequenceRecord
from lfield.replication.transfer.effects import Send
from lfield.replication.transfer.transfer_sender import LIMIT
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.engine_interface import Trap
from lfield.vm.machine import Machine
from lfield.wire.coordinator_messages import CoordinatorState, StopCoordinator

#: Seconds between two orders for a coordinator to end: at the last order it may have been in transit.
REPEAT_EVERY = 1.0


class _Waiter(NamedTuple):
    """A coordinator that waits here until another one may start or has ended, or its request is on disk."""

    agent: Agent
    about: str
    until: Literal["start", "end", "written"]


class SequencingService(Part):
    """The startable coordinators of one host, and the ends of others that are ordered here."""

    def __init__(
        self, context: HostContext, team: CoordinatorOperations, leases: LeaseRules, machine: Machine
    ) -> None:
        self._team, self._leases, self._machine = team, leases, machine
        self._hosts, self._homes, self._own_host = context.team.hosts, context.team.homes, context.name
        self._out, self._log, self._clock = context.effects.append, context.log, context.clock
        self._has_journal, mission = context.has_journal, context.mission
        self._access, self._without = mission.access, mission.bindings.start.without
        records = (record for record in context.records if isinstance(record, SequenceRecord))
        record_by_agent = {record.agent: record for record in records}
        others = [host for host in self._hosts if host != context.name]
        #: The startable coordinators of this host.
        self._runs = {
            member.id: StartableRuns(member.id, others, record_by_agent.get(member.id))
            for member in context.team.members_on(context.own_number)
            if member.is_startable
        }
        self.is_polled = bool(self._runs)
        self._waiting: dict[str, _Waiter] = {}
        #: The batch with the last record of each coordinator.
        self._batches: dict[str, int] = {}
        self._is_open, self._repeat_at = False, 0.0
        self.handles = {StopCoordinator: self._on_stop_order}
        self.observes = {LinkOpened: self._on_link_opened, LinkClosed: self._on_link_closed}

    @property
    def own_agents(self) -> Collection[str]:
        """The startable coordinators of this host."""
        return self._runs

    @property
    def startable_now(self) -> list[str]:
        """The startable coordinators of this host that do not run."""
        known = self._known
        return [name for name, runs in self._runs.items() if not runs.where(known)]

    @property
    def needed_hosts(self) -> set[str]:
        """The hosts whose reports a start waits for, and all hosts while an end is ordered."""
        if any(runs.record.stopping for runs in self._runs.values()):
            return {*self._hosts} - {self._own_host}
        return {host for waiter in self._waiting.values() for host in self._runs[waiter.about].missing}

    @property
    def _known(self) -> list[CoordinatorState]:
        return self._team.mobility.known_states()

    # --- events ---------------------------------------------------------------------------------------

    def open(self, *, first: bool) -> None:
        """Permit starts from now on, because the other hosts had time to report their records.

        `first`: an operator asserts that there was no earlier start.
        """
        is_known = first or self._team.recovery.last_start is not None
        for runs in self._runs.values():
            runs.open(is_known=is_known, without=self._without)
        self._is_open = True

    def _on_link_opened(self, event: LinkOpened) -> None:
        for runs in self._runs.values():
            runs.gate.on_states(event.hello.host, event.hello.coordinators)

    def _on_link_closed(self, event: LinkClosed) -> None:
        for runs in self._runs.values():
            runs.gate.on_unlinked(event.host)

    def on_host_exited(self, host: str) -> None:
        """A host has ended permanently: it has no coordinator any more."""
        for runs in self._runs.values():
            runs.gate.on_states(host)

    def on_tick(self, now: float) -> None:
        """Continue the coordinators whose wait is over, and repeat orders."""
        self.due = None
        if self._team.is_halted:
            return
        for name, waiter in list(self._waiting.items()):
            agent = waiter.agent
            is_here = self._machine.agents.get(name) is agent and agent.frozen
            if not is_here or self._team.is_departing(agent):
                del self._waiting[name]
            elif self._is_over(waiter):
                del self._waiting[name]
                self._machine.unfreeze(agent)
        self._repeat_orders(now)

    def _is_over(self, waiter: _Waiter) -> bool:
        runs = self._runs[waiter.about]
        match waiter.until:
            case "end":
                return not runs.where(self._known)
            case "start":
                return self._may_start(runs)
            case "written":
                return self._is_written(waiter.about)

    # --- requests -------------------------------------------------------------------------------------

    def start(self, asking: Agent, member: TeamMember, request: int) -> bool | None:
        """See `Sequencer.start`."""
        runs = self._runs[member.id]
        self._require_right(asking, member, "start")
        if runs.started_by(request):
            return self._when_written(asking, member)
        if where := runs.where(self._known):
            hint = "stop it, or wait for its end with awaitEnd"
            self._refuse(asking, "start", "ReservedException", f"{member.id} runs {where} already; {hint}")
        if not self._may_start(runs):
            self._waiting[asking.id] = _Waiter(asking, member.id, "start")
            return None
        record = runs.next_record(self._known, self._leases.quorum.fences.token_of(member.id), request)
        line = log_messages.SEQUENCE_STARTED.line(agent=member.id, by=asking.id, generation=record.generation)
        self._write(asking, runs, record, line)
        self._team.apply_effects(self._team.mobility.start(member.id, record.generation))
        return self._when_written(asking, member)

    def has_started(self, member: TeamMember, request: int) -> bool:
        """See `Sequencer.has_started`."""
        return self._runs[member.id].started_by(request) and self._is_written(member.id)

    def stop(self, asking: Agent, member: TeamMember) -> bool | None:
        """See `Sequencer.stop`."""
        runs = self._runs[member.id]
        self._require_right(asking, member, "stop")
        self._require_other(asking, member, "stop")
        if not runs.where(self._known):
            return True
        if not runs.record.stopping:
            record = SequenceRecord(member.id, runs.record.generation, runs.record.request, asking.id)
            line = log_messages.SEQUENCE_STOPPING.line(agent=member.id, by=asking.id)
            self._write(asking, runs, record, line)
            self._repeat_at = 0.0
        return self._when_written(asking, member)

    def end_of(self, asking: Agent, member: TeamMember) -> str | None:
        """See `Sequencer.end_of`."""
        runs = self._runs[member.id]
        self._require_other(asking, member, "awaitEnd")
        if runs.where(self._known):
            self._waiting[asking.id] = _Waiter(asking, member.id, "end")
            return None
        return runs.outcome(self._known)

    def is_running(self, asking: Agent, member: TeamMember) -> bool | None:
        """See `Sequencer.is_running`."""
        return bool(self._runs[member.id].where(self._known))

    def abandon_wait(self, agent: Agent) -> bool:
        """Cancel the wait of a coordinator; returns whether it waited."""
        waiter = self._waiting.get(agent.id)
        if waiter is None or waiter.agent is not agent:
            return False
        del self._waiting[agent.id]
        return True

    def wait_reason(self, agent: Agent) -> str:
        """A short text about what a suspended coordinator waits for; '' if it does not wait here."""
        waiter = self._waiting.get(agent.id)
        return f"waits for {waiter.about}" if waiter is not None and waiter.agent is agent else ""

    def _may_start(self, runs: StartableRuns) -> bool:
        """Whether a start may be made: no host may have an earlier one alive, and a lease holds if needed."""
        if not self._is_open or runs.missing:
            return False
        if runs.agent in self._leases.leased_agents and self._leases.has_to_wait:
            self._leases.request()
            return False
        return True

    def _require_right(self, asking: Agent, member: TeamMember, function: str) -> None:
        if reason := self._access.refusal(asking.member, member, function):
            self._refuse(asking, function, "AccessException", reason)

    def _require_other(self, asking: Agent, member: TeamMember, function: str) -> None:
        if asking.id == member.id:
            reason = f"{asking.id} cannot wait for its own end; it ends when its init returns"
            self._refuse(asking, function, "ConstraintException", reason)

    def _refuse(self, asking: Agent, function: str, kind: str, reason: str) -> NoReturn:
        self._log(log_messages.SEQUENCE_REFUSED.line(agent=asking.id, function=function, reason=reason))
        raise Trap(kind, reason)

    # --- records --------------------------------------------------------------------------------------

    def _write(self, asking: Agent, runs: StartableRuns, record: SequenceRecord, line: LogLine) -> None:
        """Record a request, and log it when it is on disk; records of the same turn are in the same batch."""
        if self._team.write_problem:
            reason = f"{self._own_host} cannot write its journal: {self._team.write_problem}"
            self._refuse(asking, runs.agent, LIMIT, reason)
        runs.on_recorded(record)
        if not self._has_journal:
            self._log(line)
            return
        batch = self._team.write_ahead.add_record(record, self._clock.monotonic())
        self._batches[runs.agent] = batch
        self._team.write_ahead.when_durable(batch, partial(self._log, line))

    def _is_written(self, name: str) -> bool:
        return self._batches.get(name, 0) <= self._team.write_ahead.durable

    def _when_written(self, asking: Agent, member: TeamMember) -> bool | None:
        if self._is_written(member.id):
            return True
        self._waiting[asking.id] = _Waiter(asking, member.id, "written")
        return None

    # --- ends -----------------------------------------------------------------------------------------

    def _repeat_orders(self, now: float) -> None:
        """Order the ends of coordinators on all hosts, until the ends are known."""
        stopping = [runs for runs in self._runs.values() if runs.record.stopping]
        if not stopping:
            return
        known = self._known
        for runs in stopping:
            record = runs.record
            if not runs.where(known):
                runs.on_recorded(SequenceRecord(record.agent, record.generation, record.request))
                if self._has_journal:
                    self._team.write_ahead.add_record(runs.record, now, is_lazy=True)
            elif now >= self._repeat_at and self._is_written(record.agent):
                order = StopCoordinator(record.agent, record.generation, record.stopping)
                for host in self._team.mobility.state_ids:
                    self._out(Send(host, order))
                self._stop_here(order)
        if now >= self._repeat_at and all(self._is_written(runs.agent) for runs in stopping):
            self._repeat_at = now + REPEAT_EVERY
        self.due = self._repeat_at if self._repeat_at > now else None

    def _on_stop_order(self, host: str, order: StopCoordinator) -> None:
        if self._homes.get(order.agent) == host:
            self._stop_here(order)

    def _stop_here(self, order: StopCoordinator) -> None:
        """End a coordinator that is here, if it is of that run."""
        agent = self._machine.agents.get(order.agent)
        if agent is None or agent.ended:
            return
        known = [row.generation for row in self._known if row.agent == order.agent]
        if is_of_run(agent.generation, order.generation, known):
            self._machine.stop_coordinator(agent, f"it was stopped by {order.by}")
