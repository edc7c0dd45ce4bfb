"""The coordinators of one host: their hops, with the effects of the transfer protocol. Sans-IO.

Effects that need a record on disk first wait in the write-ahead queue. On a host without a journal no effect
waits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import get_args

from lfield.errors import BlockError
from lfield.host.context import HostContext, LinkClosed, LinkOpened, Part, WriteFailed
from lfield.host.effects import WAKE_WAITERS, PersistRecords, WriteLog, WriteLogOnce
from lfield.host.events.migration_events import HopStep, MigrationEvents
from lfield.host.migration.effect_executor import Acknowledgements, EffectExecutor
from lfield.host.migration.write_ahead import JournalContents, WriteAheadQueue, downtime, program_record
from lfield.host.team.part_interfaces import MessageRelay
from lfield.journal.records import BundleRecord, Record, RunMarker, StartCounter
from lfield.replication.lease.quorum_members import FencingTokens
from lfield.replication.transfer import effects as mobile
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.core import Mobility, MobilityMessage
from lfield.replication.transfer.transfer_sender import LIMIT, MAYBE_STARTED, PAUSED, RESTARTED, UNREACHABLE
from lfield.text import log_messages
from lfield.text.log_messages import LogLine
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.machine import Machine
from lfield.vm.memory import layout
from lfield.wire.coordinator_messages import CoordinatorState, Outcome, Terminated, TerminatedAck, Transfer
from lfield.wire.fields import truncate
from lfield.wire.framing import Buffer
from lfield.wire.messages import Backpressure, Pong, RelayedMessage


class Coordinators(Part):
    """The coordinators that are on a host, arrive or leave. `fences` reject starts that may not run any
    more."""

    def __init__(
        self,
        context: HostContext,
        machine: Machine,
        mobility: Mobility,
        relay: MessageRelay,
        acks: Acknowledgements,
        fences: FencingTokens,
        migrations: MigrationEvents,
    ) -> None:
        self._machine, self._fences, self._hybrid_clock = machine, fences, context.recorder.hybrid_clock
        self._mission, self._hello, self._clock = context.mission, context.greeting, context.clock
        self._hops, self._now, self._effects = migrations.hops, context.clock.monotonic, context.effects
        self._migrations, self._downtime = migrations, partial(downtime, context.times, context.clock)
        mission, hello = context.mission, context.greeting
        self._leased = context.leased_agents
        #: The limits of each coordinator.
        self._limits = {
            member.id: context.mission.bindings.limits(member.id) for member in context.team.coordinators
        }
        self._members = {member.id: member for member in context.team.coordinators}
        self.mobility, self._relay, self._out, self._acks = mobility, relay, relay.send, acks
        self._executor = EffectExecutor(context, machine, migrations, acks, relay.send, self._start)
        self.recovery = JournalContents(context.records, hello.mission_hash, mission.release.digest)
        self.write_ahead = WriteAheadQueue(
            [] if self.recovery.has_program_record else [program_record(mission, hello.mission_hash)]
        )
        self.mobility.restore(self.recovery.copies, self.recovery.parked)
        #: Whether an operator paused the mission; the ballot that holds it (b"": none); whether either did.
        self.is_pause_ordered, self.ballot = self.recovery.paused, b""
        self.paused = self.is_pause_ordered
        #: The reason why an emergency stop locks the devices here, '' for none.
        self.stopped = self.recovery.stopped
        #: The reason why the disk should admit nothing more, '' if it may.
        self.space_problem = ""
        self._has_record = self.recovery.last_start is not None
        #: The reason why records cannot be written now, '' if they can.
        self.write_problem = ""
        #: The starts that were informed that a pending call may have started before the restart of the host.
        self.restart_notified: set[tuple[str, int]] = set()
        #: Whether this host admits no coordinator any more.
        self.is_halted = False
        #: Coordinators that arrived before the resources here were started; None after that.
        self._queued_arrivals: dict[tuple[str, int], tuple[str, Transfer, memoryview, float]] | None = {}
        #: The number of packed blocks; that of the last one, 0 if its coordinator has waited since.
        self._packs = self._packed = 0
        #: The time when mobility may have a time-out. New deadlines are later, so a set one is kept.
        self._deadline: float | None = None
        self.handles = {
            **dict.fromkeys(get_args(MobilityMessage), self._on_message),
            Pong: lambda host, _: self.apply_effects(self.mobility.on_probe_answer(host)),
            Backpressure: self._on_backpressure,
            RelayedMessage: lambda host, relayed: self.apply_effects(relay.on_relayed(host, relayed)),
        }
        self.observes = {
            LinkOpened: self._on_link_opened,
            LinkClosed: self._on_link_closed,
            WriteFailed: self._on_write_failed,
        }

    # --- time -----------------------------------------------------------------------------------------

    def on_tick(self, now: float) -> None:
        """A deadline of mobility has passed."""
        self.apply_effects(self.mobility.tick(now))
        self._set_deadline()

    def _set_deadline(self) -> None:
        self._deadline = self.mobility.next_deadline()
        self.due = None if self.paused else self._deadline

    def set_paused(self, *, ordered: bool, ballot: bytes) -> None:
        """Set the pauses by an operator and by a ballot. When neither pauses the mission any more, the
        time-outs of coordinators that wait for another host restart.
        """
        self.is_pause_ordered, self.ballot = ordered, ballot
        self.paused = is_paused = ordered or bool(ballot)
        if not is_paused:
            self.mobility.postpone(self._clock.monotonic())
        self.due = None if is_paused else self._deadline

    def set_stopped(self, reason: str) -> None:
        """An emergency stop locks the devices of this host, for that reason; '' for none."""
        self.stopped = reason

    def set_space_problem(self, problem: str) -> None:
        """The reason why the journal should admit nothing more, '' if it may."""
        self.space_problem = problem

    @property
    def backpressure(self) -> Backpressure:
        """Whether a coordinator may come here, as announced to other hosts."""
        return Backpressure(truncate(PAUSED if self.paused else self.space_problem))

    def next_batches(self) -> list[PersistRecords]:
        """The batches to write now."""
        found = self.write_ahead.next_batch(self._clock.monotonic()) if self._hello.journal_id else None
        return [PersistRecords(*found)] if found else []

    def _on_write_failed(self, event: WriteFailed) -> None:
        """Keep coordinators on this host, without calls that have side effects."""
        reason = event.reason
        if not self.write_problem:
            self.log(log_messages.JOURNAL_BLOCKED.line(reason=reason))
        self.write_problem = reason
        for identity in sorted(self._executor.saving & self._machine.agents.keys()):
            self._refuse_if_not_durable(self._machine.agents[identity])
        self._executor.saving.clear()

    def on_durable(self, number: int) -> None:
        """All batches up to this one are on disk."""
        if self.write_problem:
            self.log(log_messages.JOURNAL_WRITABLE.line())
        for effect in self.write_ahead.on_durable(number):
            self._executor.execute(effect)
        # After the other updates: records that have waited until now are not on disk.
        self.write_problem = ""
        self.write_ahead.run_actions()

    # --- arrival and departure ------------------------------------------------------------------------

    def on_resources_started(self) -> None:
        """The resources here are started: admit the coordinators that arrived before."""
        if self._mission.release.by:
            self.persist(BundleRecord(self._mission.release.digest))
        early, self._queued_arrivals = self._queued_arrivals or {}, None
        for host, header, block, sent_at in early.values():
            self.on_transfer(host, header, block, self._clock.monotonic() - sent_at)

    def resume_from_journal(self) -> None:
        if self.paused:
            self.log(log_messages.MISSION_STILL_PAUSED.line())
        now = self._clock.monotonic()
        self.apply_effects(self.mobility.resume_restored(self._restore_into_vm, now))
        self._set_deadline()
        self._relay.arm()

    # --- links ----------------------------------------------------------------------------------------

    def _on_link_opened(self, event: LinkOpened) -> None:
        if self.backpressure.reason:
            self._out(mobile.Send(event.hello.host, self.backpressure))
        self.apply_effects(self.mobility.on_linked(event.hello))
        self._relay.arm()

    def _on_link_closed(self, event: LinkClosed) -> None:
        self.mobility.on_unlinked(event.host)
        self._relay.arm()

    def _on_message(self, host: str, message: MobilityMessage) -> None:
        self.apply_effects(self.mobility.on_message(host, message, self._clock.monotonic()))
        if isinstance(message, Terminated | TerminatedAck):
            self._out(WAKE_WAITERS)

    def _on_backpressure(self, host: str, message: Backpressure) -> None:
        self.apply_effects(self.mobility.on_backpressure(host, message.reason))

    # --- the journal ----------------------------------------------------------------------------------

    def record_start(self, generation: int) -> int:
        """Record the number of a start, in a run that may be resumed; returns the number of the batch."""
        now = self._clock.monotonic()
        self.write_ahead.add_record(RunMarker(open=True), now)
        self._has_record = True
        return self.write_ahead.add_record(StartCounter(generation), now)

    def record_existence(self) -> None:
        """Record that this host has a journal, even if it has made no start, unless a start is recorded."""
        if not self._has_record:
            self.persist(StartCounter(0))

    def persist(self, record: Record) -> None:
        """Write a record as soon as possible; ignored without a journal."""
        if self._hello.journal_id:
            self.write_ahead.add_record(record, self._clock.monotonic())

    def suspend_all(self) -> None:
        """The host stops in order: no coordinator runs any more."""
        self.is_halted = True
        self._acks.flush()

    def end_run(self) -> None:
        """The host has stopped in order: the next start is a new run, unless a coordinator may continue.

        It does not end if this host has opened no device: an automatic retry must not start a mission again.
        """
        if not self._hello.journal_id or self._queued_arrivals is not None:
            return
        own_number, known = self._mission.team.number(self._hello.host), self.mobility.known_states()
        own = {member.id for member in self._members.values() if member.host == own_number}
        going = any(row.agent in own and row.state != "EXITED" for row in known)
        self.write_ahead.add_record(RunMarker(open=going), self._clock.monotonic())
        initial = [member.id for member in self._mission.team.initial_coordinators]
        if self._mission.release.by and self.recovery.is_mission_over(initial, known):
            self.persist(BundleRecord(b""))

    def on_transfer(self, host: str, header: Transfer, block: memoryview, transit: float = 0.0) -> None:
        """End of a hop: a coordinator arrived after `transit` seconds, and runs before any reply."""
        if self._queued_arrivals is not None:
            if header.agent in self._members:
                sent_at = self._clock.monotonic() - transit
                self._queued_arrivals[header.agent, header.generation] = host, header, block, sent_at
            return
        now = self._now()
        self._hybrid_clock.merge(host, header.stamp, now)
        self._hops.append((HopStep.ARRIVED, now, host, header))
        inject = partial(self._inject, transit)
        self.apply_effects(self.mobility.on_transfer(host, header, block, inject))

    def handshake_states(self) -> list[CoordinatorState]:
        """The states of all coordinators for a Hello."""
        waiting = (header for _, header, *_ in (self._queued_arrivals or {}).values())
        return self.write_ahead.durable_states(self.mobility.handshake_states(waiting), self._hello.host)

    def recover(self, agent: str, generation: int) -> bool:
        """Resume a coordinator whose holder is lost as start `generation`, once this start is on disk.

        Returns False, without an effect, if its block here is unreadable.
        """
        effects = self.mobility.recover(agent, generation, partial(self._restore_into_vm, runs=False))
        if effects:
            self.log(log_messages.AGENT_RECOVERED.line(agent=agent, generation=generation))
        self.apply_effects(effects)
        return bool(effects)

    def depart(self, agent: Agent, resource: TeamMember, lost_reason: str, down_for: float) -> None:
        """Start a hop: send a frozen coordinator to the host of a resource.

        `down_for`: seconds without a link to that host. With a `lost_reason` the call fails, unless the
        coordinator fetches a result, which may still be there. A coordinator that waits for the first of
        several results has already waited for that host, and must not miss the results of other hosts.
        """
        if self.write_problem and self._refuse_if_not_durable(agent):
            return
        target, since = self._mission.team.hosts[resource.host], self._clock.monotonic()
        if (lost_reason or down_for) and not self._machine.itinerary.is_fetching(agent):
            if lost_reason:
                self._executor.resume(agent, UNREACHABLE, lost_reason)
                return
            since -= down_for
        elif down_for and self._machine.itinerary.head(agent) == "next":
            since -= down_for
        self.apply_effects(self.mobility.depart(agent.id, target, self._block_maker(agent), since))
        self._packed = 0
        if self._deadline is None:
            self._set_deadline()

    def save(self, agent: Agent) -> bool:
        """Save a coordinator that calls another portal here; returns whether it may continue before the
        write.
        """
        if not self._hello.journal_id:
            return True
        if self._refuse_if_not_durable(agent):
            return False
        self._executor.saving.add(agent.id)
        self.apply_effects(self.mobility.save(agent.id, self._machine.pack(agent)))
        return False

    def is_departing(self, agent: Agent) -> bool:
        """Whether a frozen coordinator waits to move to another host, or may have arrived there."""
        return self.mobility.is_departing(agent.id, agent.generation)

    def _refuse_if_not_durable(self, agent: Agent) -> bool:
        """Refuse a call because its caller's state cannot be written; the caller gets an exception."""
        if self.write_problem:
            self._executor.resume(
                agent, LIMIT, f"{self._hello.host} cannot write its journal: {self.write_problem}"
            )
        return bool(self.write_problem)

    def on_agent_ended(self, agent: Agent) -> None:
        """A coordinator has finished or died."""
        outcome: Outcome = "done" if agent.ended == "done" else "died"
        self.apply_effects(self.mobility.on_ended(agent.id, agent.generation, outcome, agent.report))

    def _block_maker(self, agent: Agent) -> Callable[[int], Buffer]:
        """Pack the block of a coordinator; returns a function from a transfer's sequence to the bytes."""
        self._machine.pack(agent)
        self._packs += 1
        self._packed = self._packs
        return partial(self._seal, agent, self._packs)

    def _seal(self, agent: Agent, packed: int, sequence: int) -> Buffer:
        """The bytes of a packed block with the sequence of a transfer; `packed` is the number of the pack."""
        agent.block.w[layout.W_SEQUENCE] = sequence
        if self._packed != packed:  # The coordinator has waited since, and its time limits have decreased.
            self._machine.store_clock(agent)
        # As `Block.image`, which `pack` has called.
        return memoryview(agent.block.data)[: 8 * agent.block.top]

    def _inject(self, transit: float, header: Transfer, block: Buffer) -> mobile.TransferRefusal | None:
        if self.is_halted:
            return mobile.TransferRefusal(UNREACHABLE, f"{self._hello.host} is stopping")
        if header.agent in self._leased and self._fences.rejects(header.agent, header.generation):
            reason = f"on {self._hello.host} this start of {header.agent} is fenced"
            return mobile.TransferRefusal(UNREACHABLE, reason)
        member = self._members.get(header.agent)
        if member is None:
            return mobile.TransferRefusal(
                UNREACHABLE, f"{self._hello.host} knows no coordinator {header.agent}"
            )
        try:
            self._machine.inject(member, memoryview(block), self._limits[member.id], transit)
        except BlockError as error:
            self._out(WriteLogOnce(log_messages.MIGRATION_REFUSED.line(agent=header.agent, reason=error)))
            return mobile.TransferRefusal(UNREACHABLE, f"{self._hello.host} refused the coordinator: {error}")
        return None

    def _restore_into_vm(self, copy: CoordinatorCopy, *, runs: bool) -> Callable[[int], Buffer] | None:
        """Load a stored coordinator into the machine again."""
        if copy.block is None:
            # The coordinator never reached a portal call with side effects: none of its actions was visible
            # outside.
            self._start(copy.agent, copy.generation)
            self.log(log_messages.AGENT_RESTARTED.line(agent=copy.agent, host=self._hello.host))
            # The block is not needed before the coordinator reaches a portal call.
            return _empty_block
        member = self._members[copy.agent]
        try:
            limits = self._limits[member.id]
            agent = self._machine.restore(member, memoryview(copy.block), limits, self._downtime(copy))
        except BlockError as error:
            self.log(log_messages.AGENT_UNREADABLE.line(agent=copy.agent, reason=error))
            return None
        # The copy may have been stored on arrival, before the arrival was counted; or during a recovery.
        recovered = agent.block.w[layout.W_GENERATION] != copy.generation
        agent.block.w[layout.W_HOPS], agent.block.w[layout.W_GENERATION] = copy.hops, copy.generation
        seal = self._block_maker(agent)
        self._packed = 0
        if runs:
            self.log(log_messages.AGENT_RESUMED.line(agent=copy.agent))
        if runs and not recovered and self._machine.itinerary.may_continue(agent):
            self._machine.unfreeze(agent)
        elif runs:
            self.restart_notified.add((agent.id, agent.generation))
            reason = f"{self._hello.host} restarted; {MAYBE_STARTED}"
            self._executor.resume(agent, RESTARTED, reason, recovered=recovered)
        return seal

    def _start(self, agent: str, generation: int) -> None:
        self._machine.start(self._members[agent], self._limits[agent], generation)

    def apply_effects(self, effects: Iterable[mobile.Effect]) -> None:
        """Execute effects that need not wait, and queue the rest."""
        for effect in (
            self.write_ahead.put(effects, self._clock.monotonic()) if self._hello.journal_id else effects
        ):
            self._executor.execute(effect)

    def log(self, line: LogLine) -> None:
        """Write a log line."""
        self._out(WriteLog(line))


def _empty_block(sequence: int) -> Buffer:
    return b""
