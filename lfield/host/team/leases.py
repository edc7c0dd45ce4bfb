"""Leases and fences of one host: their effects on its coordinators and the devices that they use. Sans-IO.

A coordinator that runs under a lease (`Mission.fenced`) starts no portal call, and actuates no device, while
this host holds no lease. When the lease ends, or a coordinator is fenced, the devices that it has used here
go into their safe states.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from typing import get_args

from lfield.errors import DeviceError
from lfield.host.context import HostContext, Part
from lfield.host.effects import MakeDeviceSafe, WriteLog
from lfield.host.team.part_interfaces import CoordinatorOperations
from lfield.journal.records import FenceRecord
from lfield.replication.lease import effects as quorum
from lfield.replication.lease.core import Quorum
from lfield.replication.lease.effects import Checkpoint
from lfield.replication.lease.quorum_members import FencingTokens, QuorumMembers
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.effects import DropTerminated, PersistRecord, Send
from lfield.replication.transfer.generations import next_recovery
from lfield.replication.transfer.transfer_sender import MAYBE_STARTED, RESTARTED
from lfield.text import log_messages
from lfield.text.suggestions import listed
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.memory.layout import W_INTERVAL, W_SEQUENCE
from lfield.vm.pending_call import PendingCall
from lfield.wire.coordinator_messages import TERMINATED, CheckpointId, LeaseRecord, Terminated
from lfield.wire.fields import bounded_duration
from lfield.wire.framing import Buffer
from lfield.wire.quorum_messages import QuorumMessage

#: The caller of a portal: a coordinator that waits here for the portal, or a pending call of a coordinator.
Caller = Agent | PendingCall

#: The reason why calls of coordinators fail on a host without a lease.
ENDED = "the lease of {0} has ended: no majority of the members responds"
#: The reason why a host without a lease does not recover a coordinator: the host may have missed its
#: termination, and the coordinator could not act.
NO_MAJORITY = (
    "{0} runs under leases, and no majority of the members responds to {1}; they may know that {0} has "
    "ended: retry when they respond; if members are permanently lost, restart all hosts with a 'recovery: "
    "{{members: [...]}}' without them"
)


class TeamLeases(Part):
    """The leases of one host, none without a journal. `fences` are the fences of its coordinators."""

    def __init__(
        self, context: HostContext, team: CoordinatorOperations, machine: Machine, fences: FencingTokens
    ) -> None:
        self._mission, self._hello, self._clock = context.mission, context.greeting, context.clock
        self._team, self._machine, self._out = team, machine, context.effects.append
        mission, hello, clock = context.mission, context.greeting, context.clock
        #: The coordinators that run under leases.
        self.leased_agents = context.leased_agents
        self.is_polled = bool(self.leased_agents)
        self._restored = context.restored_fences
        hosts = mission.team.hosts if self.leased_agents else ()
        others = [host for host in hosts if host != hello.host]
        #: Whether no record of earlier incarnations exists here.
        self._new = team.recovery.last_start is None
        members = QuorumMembers(
            mission.recovery.members, hello.host, mission.recovery.lease, knows_promises=not self._new
        )
        self.quorum = Quorum(
            members, others, self.leased_agents, hello.incarnation, self, fences, context.rng
        )
        #: Whether the lease was gained since the last `poll_gained`.
        self._is_gained = False
        self.handles = dict.fromkeys(get_args(QuorumMessage), self._on_message)
        team.mobility.set_delay_rule(lambda ended: self.quorum.is_delayed(ended, clock.monotonic()))
        self._safe = {device.name: device.safe_state for device in mission.devices_of(hello.host)}
        #: The devices that were used here for coordinators under leases.
        self._users: dict[str, set[Caller]] = {}
        self._waiting: dict[str, Agent] = {}
        self._is_held = False
        #: The members that were logged as missing. All hosts of a team may just be starting, so no line is
        #: logged before that time.
        self._reported_missing: list[str] = []
        self._wait_until = math.inf

    # --- time -----------------------------------------------------------------------------------------

    def start(self, *, first: bool) -> None:
        """The host is up. `first`: an operator asserts that it was never started before."""
        if self.leased_agents:
            self.quorum.start(self._clock.monotonic(), first=first)
            self._update_due()
            if self._hello.host in self._mission.recovery.members:
                self._wait_until = self._clock.monotonic() + self._mission.recovery.lease
        elif self._mission.fenced:
            self._out(WriteLog(log_messages.NO_HEARTBEAT_INTERVAL.line(host=self._hello.host)))

    def on_restored(self) -> None:
        """Stored coordinators are about to resume: fence the coordinators that may not."""
        for agent, generation in self._restored.items():
            self._raise_fence(agent, generation, "according to its journal")

    def _update_due(self) -> None:
        due = self.quorum.due
        self.due = min(due, self.quorum.lease.valid_until) if due is not None and self._is_held else due

    def on_tick(self, now: float) -> None:
        """Process time-outs and messages."""
        self._apply_effects(self.quorum.tick(now))
        if self._new and self.quorum.knows_promises:
            # After a restart this host need not wait for all members again.
            self._new = False
            self._team.record_existence()
        if now >= self._wait_until:
            self._report_missing()
        was_held, self._is_held = self._is_held, self.quorum.lease.holds(now)
        if was_held and not self._is_held:
            self._on_lost()
        elif self._is_held and not was_held:
            self._on_gained()
        self._is_gained = self._is_held and not was_held
        self._update_due()

    def poll_gained(self) -> bool:
        """Whether the lease was gained since the last call."""
        gained, self._is_gained = self._is_gained, False
        return gained

    def _report_missing(self) -> None:
        """Log which members must report before this host's vote counts, when that has changed."""
        missing = self.quorum.unreachable_members
        if missing and missing != self._reported_missing:
            line = log_messages.NO_LEASE_GIVEN.line(host=self._hello.host, members=listed(missing))
            self._out(WriteLog(line))
        self._reported_missing = missing

    def _on_gained(self) -> None:
        """Coordinators at a portal call may start it, except those that were resumed and wait to leave."""
        waiting, self._waiting = self._waiting, {}
        for name, agent in sorted(waiting.items()):
            if self._machine.agents.get(name) is agent and not self._team.is_departing(agent):
                self._machine.unfreeze(agent)

    def _on_lost(self) -> None:
        """Calls under the lease fail, and the devices that they used go into their safe states."""
        reason = ENDED.format(self._hello.host)
        leased_callers = {caller for caller in self._callers() if self._is_leased(caller)}
        used = {device: users & leased_callers for device, users in self._users.items()}
        if leased_callers:
            self._out(WriteLog(log_messages.LEASE_LOST.line(host=self._hello.host)))
        for name in sorted({caller.id for caller in leased_callers}):
            abandon_calls(self._machine, name, f"{reason}; {MAYBE_STARTED}")
        for device, users in used.items():
            if users:
                names = tuple(sorted({caller.id for caller in users}))
                use = f"{reason}; it was used for {', '.join(names)}"
                self._out(MakeDeviceSafe(device, self._safe[device], use, names))
        self._users.clear()

    def _callers(self) -> list[Caller]:
        """The agents that are here, and pending calls here, whose coordinators may be elsewhere."""
        running = (call for call in self._machine.pending_calls.calls() if call.state == "running")
        return [*self._machine.agents.values(), *running, *self._machine.person_portals.running]

    def _is_leased(self, caller: Caller) -> bool:
        """Whether a caller acts under the lease of this host. A person does in a mission with leases: without
        a lease here, coordinators may have been resumed on other hosts."""
        is_person = isinstance(caller, PendingCall) and caller.is_of_person
        return caller.id in self.leased_agents or (is_person and bool(self.leased_agents))

    @property
    def needed_hosts(self) -> set[str]:
        """The hosts with which links are needed."""
        return self.quorum.needed_hosts if self.leased_agents else set()

    # --- permissions of coordinators ------------------------------------------------------------------

    @property
    def has_to_wait(self) -> bool:
        """Whether coordinators of this host start only under a lease."""
        return bool(self.leased_agents) and not self.quorum.lease.holds(self._clock.monotonic())

    def request(self) -> None:
        """A coordinator of this host waits for a lease to start."""
        self.quorum.request_lease(self._clock.monotonic())
        self._update_due()

    @property
    def remaining(self) -> float | None:
        """Remaining seconds of the lease, None where none is needed."""
        if not self.leased_agents:
            return None
        return bounded_duration(self.quorum.lease.valid_until - self._clock.monotonic())

    def is_waiting(self, agent: Agent) -> bool:
        """Whether a coordinator waits at a portal call for a lease."""
        return self._waiting.get(agent.id) is agent

    def may_start_call(self, agent: Agent) -> bool:
        """Whether a coordinator may start a portal call now; otherwise it is resumed later, or was
        stopped."""
        if agent.id not in self.leased_agents:
            return True
        now = self._clock.monotonic()
        if self.quorum.may_act(agent.id, agent.generation, now):
            return True
        if self.quorum.is_fenced(agent.id, agent.generation):
            self._raise_fence(agent.id, self.quorum.fences.token_of(agent.id), "it returned after that")
        else:
            self._waiting[agent.id] = agent
            self.quorum.request_lease(now)
            self._update_due()
        return False

    def abandon_wait(self, agent: Agent) -> bool:
        """Cancel a coordinator's wait for a lease; returns whether it waited."""
        if waits := self.is_waiting(agent):
            del self._waiting[agent.id]
        return waits

    def is_fenced(self, agent: str, generation: int) -> bool:
        """Whether a start of a coordinator is not admitted any more."""
        return self.quorum.is_fenced(agent, generation)

    def end_reason(self, agent: str, generation: int) -> str:
        """The reason why a start may not act any more, as far as is known here; '' if it may."""
        if self.is_fenced(agent, generation):
            return f"this start of {agent} is fenced"
        return self._team.mobility.end_reason(agent, generation)

    def recovery_blocker(self, agent: str, generation: int) -> str:
        """The reason why an operator may not recover a start of a coordinator here; '' if they may."""
        ended = self._team.mobility.termination(agent)
        if agent in self.leased_agents and (
            known := self.quorum.terminations.covering_termination(agent, generation)
        ):
            return f"{agent} has ended on {known.host} ({known.outcome}): it cannot be resumed"
        if ended is not None:
            return f"{agent} has ended on {ended.ended_on} ({ended.outcome}): it cannot be resumed"
        if agent in self.leased_agents and self.has_to_wait:
            return NO_MAJORITY.format(agent, self._hello.host)
        return ""

    def actuation_deadline(self, caller: Caller, device: str) -> float:
        """The deadline for actuating a device for a coordinator, in seconds of this host's clock.

        Raises DeviceError when it has passed.
        """
        if not self._is_leased(caller):
            return math.inf
        now = self._clock.monotonic()
        may_act = (
            self.quorum.may_act(caller.id, caller.generation, now)
            if caller.id in self.leased_agents
            else self.quorum.lease.holds(now)
        )
        if caller.ended or not may_act:
            raise DeviceError(device.rpartition(".")[2], ENDED.format(self._hello.host))
        self._users.setdefault(device, set()).add(caller)
        return self.quorum.lease.valid_until

    # --- messages -------------------------------------------------------------------------------------

    def _on_message(self, host: str, message: QuorumMessage) -> None:
        """A query, an answer or a heartbeat of a host."""
        self._apply_effects(self.quorum.on_message(host, message, self._clock.monotonic()))

    def records(self, agents: Collection[str]) -> list[LeaseRecord]:
        """The answer to a query about coordinators under leases; see `Quorum.lease_records`."""
        return self.quorum.lease_records(agents, self._clock.monotonic())

    def on_located(self, host: str, record: LeaseRecord) -> None:
        """A host reports its records of a coordinator under leases."""
        self._apply_effects(self.quorum.on_located(host, record, self._clock.monotonic()))

    def _apply_effects(self, effects: Iterable[quorum.Effect]) -> None:
        for effect in effects:
            match effect:
                case quorum.SendQuorumMessage():
                    self._team.apply_effects([Send(effect.host, effect.message)])
                case quorum.RaiseFence():
                    self._raise_fence(effect.agent, effect.generation, effect.reason)
                    record = FenceRecord(effect.agent, effect.generation)
                    self._team.apply_effects([PersistRecord(effect.agent, record)])
                case quorum.PromoteCheckpoint() if self._team.mobility.recoverable_state(effect.agent):
                    self._out(WriteLog(effect.line))
                    if not self._team.recover(effect.agent, effect.generation):
                        line = log_messages.FAILOVER_IMPOSSIBLE.line(
                            agent=effect.agent, host=self._hello.host
                        )
                        self._out(WriteLog(line))
                case quorum.RecordTermination():
                    self._on_terminated(effect.ended)
                case quorum.LogExplanation():
                    self._out(WriteLog(effect.text))

    def _on_terminated(self, ended: Terminated) -> None:
        """Another host reports the termination of a coordinator."""
        effects = self._team.mobility.on_terminated(ended)
        if any(isinstance(effect, DropTerminated) for effect in effects):
            line = log_messages.AGENT_ENDED_ELSEWHERE.line(
                agent=ended.agent, host=ended.host, outcome=ended.outcome
            )
            self._out(WriteLog(line))
        self._team.apply_effects(effects)

    def _raise_fence(self, name: str, generation: int, reason: str) -> None:
        """Fence the starts before this one: copies here stop, and their devices go into their safe states."""
        fenced_callers = {c for c in self._callers() if c.id == name and c.generation < generation}
        self._team.apply_effects(self._team.mobility.fence(name, generation, reason))
        if any(self._waiting.get(name) is caller for caller in fenced_callers):
            del self._waiting[name]
        for device, users in self._users.items():
            if users & fenced_callers:
                users -= fenced_callers
                fence_reason = f"{name}, which has used it, is fenced: {reason}"
                self._out(MakeDeviceSafe(device, self._safe[device], fence_reason, (name,)))

    # --- Copies of the quorum -------------------------------------------------------------------------

    def checkpoint(self, agent: str) -> Checkpoint | None:
        """The newest checkpoint of a coordinator here, or its termination."""
        copy = self._team.mobility.newest_copy(agent)
        if copy is None:
            return self._termination_checkpoint(agent)
        if copy.is_here:
            return Checkpoint(
                CheckpointId(copy.generation, copy.sequence, was_sent=False), is_alive=True, interval=0.0
            )
        block, is_sent = copy.block, copy.state != "RUN"
        if copy.is_unreadable:
            # Neither this copy nor an older one is resumed.
            return Checkpoint(
                CheckpointId(copy.generation, copy.sequence, is_sent), is_alive=False, interval=0.0
            )
        sequence = _header_field(block, W_SEQUENCE) if block is not None else 0
        interval = _header_field(block, W_INTERVAL) / 1000.0 if block is not None else 0.0
        return Checkpoint(CheckpointId(copy.generation, sequence, is_sent), is_alive=False, interval=interval)

    def _termination_checkpoint(self, agent: str) -> Checkpoint | None:
        """The termination of a coordinator without a copy here. It is final once a majority of the members
        has it on disk, as confirmed to the host where it ended. Until it is on disk there, the coordinator
        counts as running."""
        copy = self._team.mobility.termination(agent)
        if copy is None or not copy.outcome:
            return None
        if not self._is_on_disk(copy):
            return Checkpoint(
                CheckpointId(copy.generation, copy.sequence, was_sent=False), is_alive=True, interval=0.0
            )
        ended = Terminated(agent, copy.generation, copy.outcome, copy.detail, copy.ended_on)
        final = copy.ended_on != self._hello.host or copy.outcome == "lost" or self._is_final(copy)
        return Checkpoint(
            CheckpointId(copy.generation, copy.sequence, was_sent=False), False, 0.0, ended, final
        )

    def _is_on_disk(self, ended: CoordinatorCopy) -> bool:
        [durable] = self._team.write_ahead.durable_states([ended.state_message()], self._hello.host)
        return durable.state == "EXITED"

    def _is_final(self, ended: CoordinatorCopy) -> bool:
        """Whether a majority of the members has on disk that a coordinator has terminated here."""
        waiting = self._team.mobility.unconfirmed_by(ended.agent, ended.generation)
        members = self.quorum.members
        return self._is_on_disk(ended) and members.is_majority(members.names.difference(waiting))

    @property
    def not_final_yet(self) -> list[str]:
        """The coordinators whose termination here is not final yet, and that are not fenced."""
        found = (self._team.mobility.termination(agent) for agent in sorted(self.leased_agents))
        return [
            copy.agent
            for copy in found
            if copy is not None
            and copy.ended_on == self._hello.host
            and copy.outcome in TERMINATED
            and not self.is_fenced(copy.agent, copy.generation)
            and not self._is_final(copy)
        ]

    def allocate_generation(self, agent: str, above: int) -> int:
        """A generation that no other host allocates, greater than all known generations."""
        known = (k.generation for k in self._team.mobility.known_states() if k.agent == agent)
        return next_recovery(max([above, *known]), self._mission.team.number(self._hello.host))


def abandon_calls(machine: Machine, coordinator: str, reason: str) -> None:
    """The calls of a coordinator or person on this host have ended for the caller: they may have started."""
    if agent := machine.agents.get(coordinator):
        machine.detach_caller(agent, RESTARTED, reason)
    machine.pending_calls.fail_running(coordinator, RESTARTED, reason)
    machine.person_portals.fail_running(coordinator, RESTARTED, reason)


def _header_field(block: Buffer, index: int) -> int:
    """A word of a block's header."""
    return int.from_bytes(bytes(block[8 * index : 8 * index + 8]), "little")
