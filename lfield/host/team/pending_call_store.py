"""Durable store of pending asynchronous calls (`together`) on one host. Sans-IO (decision 46).

A call starts when its record and the block of its coordinator are on disk; its result is reported when the
result is on disk. The record is deleted with, or after, the record of the coordinator that has fetched the
result; also when the start that began the call is over: terminated, fenced, or recovered elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial

from msgspec import structs

from lfield.host.context import HostContext, Part, WriteFailed
from lfield.host.team.part_interfaces import CoordinatorOperations, LeaseRules
from lfield.journal.records import PendingCallRecord, pending_call_key
from lfield.vm.agent import Agent
from lfield.vm.machine import Machine
from lfield.vm.pending_call import CallKey, CallRequest, PendingCall

#: One start of a coordinator.
StartId = tuple[str, int]


class PendingCallStore(Part):
    """The pending calls of one host. Without a journal none of them waits for the disk."""

    def __init__(
        self, context: HostContext, team: CoordinatorOperations, leases: LeaseRules, machine: Machine
    ) -> None:
        self._mission, self._team, self._leases = context.greeting.mission_hash, team, leases
        self._machine, self._clock, self._has_journal = machine, context.clock, context.has_journal
        #: The records, and the number of the batch in which each was last written.
        self._records: dict[CallKey, tuple[PendingCallRecord, int]] = {}
        for record in context.records:
            if isinstance(record, PendingCallRecord) and record.program == self._mission:
                self._records[record.agent, record.generation, record.number] = record, 0
        #: Calls that the machine may start, until they have started.
        self._startable: list[CallKey] = []
        #: Fetched results, until a record of the coordinator contains them.
        self._fetched: dict[StartId, list[CallKey]] = {}
        self.observes = {WriteFailed: self._on_write_failed}

    def restore(self) -> None:
        """The resources are started: calls under way before the restart are lost."""
        self._machine.pending_calls.restore(
            [_pending_call(record, self._leases) for record, _ in self._records.values()]
        )
        self.is_polled = bool(self._records)

    def on_restored(self) -> None:
        """The coordinators of this host resume: those that were informed that their calls may have started
        fetch no result.
        """
        notified = [
            key
            for key, (record, _) in self._records.items()
            if key[:2] in self._team.restart_notified and not record.outcome
        ]
        self._machine.pending_calls.forget(notified)
        self._delete(notified)

    # --- called by the machine ------------------------------------------------------------------------

    def may_start_calls(self, agent: Agent, calls: Sequence[CallRequest]) -> bool:
        """See `HostInterface.may_start_calls`."""
        if not self._leases.may_start_call(agent):
            return False
        self.is_polled = True
        keys = [(agent.id, agent.generation, call.number) for call in calls]
        if not self._has_journal:
            return True
        if agent.is_persisted and all(self._is_durable(key) for key in keys):
            self._startable += keys
            return True
        new_calls = [call for key, call in zip(keys, calls, strict=True) if key not in self._records]
        if new_calls and not self._team.write_problem:
            for call in new_calls:
                self._add_record(agent, call)
        if new_calls:
            self.on_save(agent)
        return False

    def _is_durable(self, key: CallKey) -> bool:
        return key in self._records and self._records[key][1] <= self._team.write_ahead.durable

    def _add_record(self, agent: Agent, call: CallRequest) -> None:
        record = PendingCallRecord(
            agent.id, agent.generation, call.number, call.resource, call.portal, program=self._mission
        )
        self._persist(record)

    def _persist(self, record: PendingCallRecord) -> int:
        batch = self._team.write_ahead.add_record(record, self._clock.monotonic())
        self._records[record.agent, record.generation, record.number] = record, batch
        return batch

    def on_call_completed(self, pending: PendingCall) -> None:
        """See `HostInterface.on_call_completed`."""
        if not self._has_journal:
            self._machine.pending_calls.on_persisted(pending.key)
        elif (found := self._records.get(pending.key)) and not pending.dropped:
            outcome = "done" if pending.state == "done" else "thrown"
            batch = self._persist(structs.replace(found[0], outcome=outcome, result=pending.result))
            self._team.write_ahead.when_durable(batch, partial(self._on_result_durable, pending.key))

    # --- journal --------------------------------------------------------------------------------------

    def _on_result_durable(self, key: CallKey) -> None:
        """A result on disk may be reported, unless the calls of the start were cancelled during the write."""
        if key in self._records:
            self._machine.pending_calls.on_persisted(key)

    def on_save(self, agent: Agent) -> bool:
        """Delete the fetched results of a coordinator when it is saved: the stored block contains them.

        Returns whether the coordinator may continue before the write.
        """
        may_continue = self._team.save(agent)
        if self._has_journal and not self._team.write_problem:
            before = self._fetched.pop((agent.id, agent.generation), [])
            self._delete([*before, *self._machine.pending_calls.drain_fetched(agent)])
        return may_continue

    def on_departing(self, agent: Agent) -> None:
        """A coordinator was packed to be sent: its fetched results are deleted when the copy is on disk."""
        if self._has_journal and (fetched := self._machine.pending_calls.drain_fetched(agent)):
            self._fetched.setdefault((agent.id, agent.generation), []).extend(fetched)
            self.is_polled = True

    def _on_write_failed(self, event: WriteFailed) -> None:
        """Calls that waited for the disk are not started."""
        waiting = [
            key
            for key, (record, batch) in self._records.items()
            if batch > self._team.write_ahead.durable and not record.outcome
        ]
        self._delete(waiting)

    # --- cleanup --------------------------------------------------------------------------------------

    def on_tick(self, now: float) -> None:
        """Cancel calls of starts that are over, and delete records that no start will fetch."""
        pending = self._machine.pending_calls.calls()
        if not (pending or self._records or self._fetched or self._startable):
            self.is_polled = False
            return
        for start in list(self._fetched):
            if self._team.mobility.was_sent(*start):
                self._delete(self._fetched.pop(start))
        calls = {call.key for call in pending}
        failed = [key for key in self._startable if key not in calls and not self._records[key][0].outcome]
        self._startable.clear()
        self._delete(failed)
        starts = {key[:2] for key in calls}
        for start in sorted({*starts, *(key[:2] for key in self._records)}):
            if reason := self._end_reason(start):
                self._cancel_start(start, reason, starts)

    def _end_reason(self, start: StartId) -> str:
        """The reason why a start will not fetch its calls, '' if it may."""
        return self._leases.end_reason(*start)

    def _cancel_start(self, start: StartId, reason: str, pending: set[StartId]) -> None:
        agent, generation = start
        earlier = [other for other in pending if other[0] == agent and other[1] < generation]
        keys = [key for key in self._records if key[:2] == start]
        if start in pending and all(self._end_reason(other) for other in earlier):
            self._machine.pending_calls.cancel(agent, generation + 1, reason)
        elif start in pending:
            # Of two starts the earlier one continues.
            self._machine.pending_calls.forget(
                call.key for call in self._machine.pending_calls.calls() if call.key[:2] == start
            )
        self._fetched.pop(start, None)
        self._delete(keys)

    def _delete(self, keys: Iterable[CallKey]) -> None:
        deleted = [key for key in keys if self._records.pop(key, None)]
        if deleted:
            self._team.write_ahead.delete_records(
                [pending_call_key(*key) for key in deleted], self._clock.monotonic()
            )


def _pending_call(record: PendingCallRecord, leases: LeaseRules) -> PendingCall:
    """A stored call in the form of the machine."""
    return PendingCall(
        record.agent,
        record.generation,
        record.number,
        record.resource,
        record.portal,
        fenced=record.agent in leases.leased_agents,
        state=record.outcome or "running",
        result=record.result,
    )
