"""Write-ahead queue of a host: effects wait for the journal writes that they depend on. Sans-IO.

The effects of one coordinator keep their order, so no effect overtakes a record on which it depends; other
coordinators do not wait. Lazy records are written together with the next records that are needed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping

from msgspec import structs

from lfield.bytecode.encoding import encode
from lfield.clock import Clock
from lfield.journal.records import (
    BundleRecord,
    CoordinatorRecord,
    EmergencyStopFlag,
    PauseFlag,
    PendingCallRecord,
    ProgramRecord,
    Record,
    RecordKey,
    RunMarker,
    StartCounter,
    key_of,
)
from lfield.mission.mission import Mission
from lfield.replication.transfer.coordinator_copies import CoordinatorCopy
from lfield.replication.transfer.effects import (
    CoordinatorStarted,
    DropTerminated,
    Effect,
    LogAnomaly,
    MarkInDoubt,
    MarkMigrated,
    PersistRecord,
    ResumeCopy,
    ResumeWithException,
    Send,
    SendTransfer,
    TerminateCopy,
)
from lfield.wire.coordinator_messages import TERMINATED, CoordinatorState

#: The maximum delay of a lazy record, in seconds.
LAZY_DELAY = 1.0


#: The number of terminations remembered of each coordinator; every run makes one termination.
MAX_ENDINGS = 8


class WriteAheadQueue:
    """The waiting records and effects of one host. `first` are written with the first batch."""

    def __init__(self, first: Iterable[Record] = ()) -> None:
        self._records: dict[RecordKey, Record] = {key_of(record): record for record in first}
        #: The records to delete.
        self._deletions: set[RecordKey] = set()
        #: The number of the batch that is being collected.
        self._number = 1
        #: The number of the last batch on disk.
        self.durable = 0
        self._blocked: dict[str, deque[tuple[int, Effect]]] = {}
        #: Actions that wait for batches, in the order of the batches.
        self._actions: deque[tuple[int, Callable[[], None]]] = deque()
        self._urgent = False
        #: The latest time for writing the lazy records, None without any; seconds on the host's clock.
        self.due: float | None = None

    def put(self, effects: Iterable[Effect], now: float) -> list[Effect]:
        """Queue effects of mobility, in order; returns those that need not wait."""
        ready: list[Effect] = []
        for effect in effects:
            if isinstance(effect, PersistRecord):
                self.add_record(effect.record, now, is_lazy=effect.is_lazy)
                if not effect.is_lazy:
                    self._blocked.setdefault(effect.agent, deque()).append((self._number, effect))
            elif isinstance(effect, TerminateCopy | DropTerminated):
                # Stopping a copy needs no record: otherwise the copy would continue to run, although it has
                # ended here.
                self._discard(effect.agent, effect.generation)
                ready.append(effect)
            elif waiting := self._blocked.get(_agent(effect)):
                waiting.append((waiting[-1][0], effect))
            else:
                ready.append(effect)
        return ready

    def _discard(self, agent: str, generation: int) -> None:
        """A start is stopped: discard waiting effects that resume or send it; reports about the start are
        kept.
        """
        if waiting := self._blocked.get(agent):
            effects = (entry for entry in waiting if _generation(entry[1]) != generation)
            self._blocked[agent] = deque(effects)

    def is_pending_durable(self, agent: str) -> bool:
        """Whether an effect of a coordinator waits for the disk."""
        return agent in self._blocked

    def durable_states(self, rows: Iterable[CoordinatorState], own_host: str) -> list[CoordinatorState]:
        """The states for other hosts: a start that terminated on this host, `own_host`, counts as running
        until the termination is on disk.

        After a crash this host would resume the start. If other hosts knew of the termination, a majority
        could have it on disk by then, and it would be final.
        """
        return [self._durable_state(row, own_host) for row in rows]

    def _durable_state(self, row: CoordinatorState, own_host: str) -> CoordinatorState:
        ended = row.state == "EXITED" and row.where == own_host and row.outcome in TERMINATED
        if not ended or not self._is_end_pending(row.agent, row.generation):
            return row
        return structs.replace(row, state="RUN", where="", outcome="", detail="")

    def _is_end_pending(self, agent: str, generation: int) -> bool:
        """Whether the record of this start's termination waits for the disk."""
        waiting = (
            effect.record for _, effect in self._blocked.get(agent, ()) if isinstance(effect, PersistRecord)
        )
        records = (record for record in waiting if isinstance(record, CoordinatorRecord))
        return any(record.generation == generation and record.state == "EXITED" for record in records)

    def add_record(self, record: Record, now: float, *, is_lazy: bool = False) -> int:
        """Queue a record; returns the number of its batch."""
        self._records[key_of(record)] = record
        self._deletions.discard(key_of(record))
        self._urgent = self._urgent or not is_lazy
        return self._batch(now)

    def delete_records(self, keys: Iterable[RecordKey], now: float) -> int:
        """Queue deletions, after the records that are queued; returns the number of their batch."""
        for key in keys:
            self._records.pop(key, None)
            self._deletions.add(key)
        return self._batch(now)

    def _batch(self, now: float) -> int:
        if self.due is None:
            self.due = now + LAZY_DELAY
        return self._number

    def next_batch(self, now: float) -> tuple[int, list[Record], list[RecordKey]] | None:
        """The next batch, if one is due: its number, records to write, keys to delete."""
        if not self._urgent and (self.due is None or now < self.due):
            return None
        records, keys = list(self._records.values()), sorted(self._deletions)
        self._records, self._deletions = {}, set()
        number, self._number = self._number, self._number + 1
        self._urgent, self.due = False, None
        return number, records, keys

    def when_durable(self, batch: int, action: Callable[[], None]) -> None:
        """Queue an action until the last added batch is on disk; `run_actions` calls it."""
        self._actions.append((batch, action))

    def run_actions(self) -> None:
        """Call the actions that waited for batches that are on disk, in the order of `when_durable`."""
        while self._actions and self._actions[0][0] <= self.durable:
            self._actions.popleft()[1]()

    def on_durable(self, number: int) -> list[Effect]:
        """All batches up to this one are on disk: returns the effects that waited for them."""
        self.durable = number
        ready: list[Effect] = []
        for agent, waiting in list(self._blocked.items()):
            while waiting and waiting[0][0] <= number:
                _, effect = waiting.popleft()
                if not isinstance(effect, PersistRecord):
                    ready.append(effect)
            if not waiting:
                del self._blocked[agent]
        return ready


def program_record(mission: Mission, digest: bytes) -> ProgramRecord:
    """The record that describes the blocks of a mission for readers of the journal."""
    types = mission.team.types
    program, members = encode(mission.program), tuple(types)
    return ProgramRecord(digest, program, members, tuple(types.values()), mission.team.hosts)


class JournalContents:
    """The records of a host's journal; `mission` is the hash of its present mission (`Hello.mission_hash`),
    and `bundle` the digest of its bundle, b"" without one.

    A coordinator of another mission stays parked: it waits for its own program and deployment.
    """

    def __init__(self, records: Iterable[Record], mission: bytes, bundle: bytes = b"") -> None:
        records = list(records)
        copies = [record for record in records if isinstance(record, CoordinatorRecord)]
        ended = _outdated_endings(copies)
        deleted_keys = {key_of(record) for record in ended}
        needed_digests = {mission, *(record.program for record in copies)}
        ended_starts = {(record.agent, record.generation) for record in copies if record.state == "EXITED"}
        #: Outdated terminations, pending calls of terminated starts, and programs without blocks: to be
        #: deleted.
        self.outdated: list[Record] = [
            *ended,
            *(
                p
                for p in records
                if isinstance(p, PendingCallRecord) and (p.agent, p.generation) in ended_starts
            ),
            *(
                record
                for record in records
                if isinstance(record, ProgramRecord) and record.digest not in needed_digests
            ),
        ]
        self.copies = [
            record
            for record in copies
            if key_of(record) not in deleted_keys and (not record.block or record.program == mission)
        ]
        #: The records of other programs or deployments.
        self.parked = [record for record in copies if record.block and record.program != mission]
        #: Whether the program of this mission is recorded.
        self.has_program_record = any(
            isinstance(record, ProgramRecord) and record.digest == mission for record in records
        )
        #: Whether this host is paused.
        self.paused = any(record.on for record in records if isinstance(record, PauseFlag))
        #: The reason why an emergency stop locks the devices here, '' for none.
        self.stopped = next(
            (record.reason for record in records if isinstance(record, EmergencyStopFlag)), ""
        )
        #: The last start that was made here, None if none is recorded.
        self.last_start = next((record.count for record in records if isinstance(record, StartCounter)), None)
        #: Whether the run that was started here continues.
        self.is_run_open = any(record.open for record in records if isinstance(record, RunMarker))
        #: The starts that ended before this bundle was started here.
        self._earlier = {(record.agent, record.generation) for record in copies if record.state == "EXITED"}
        if BundleRecord(bundle) in records:
            self._earlier = set()

    def is_mission_over(self, coordinators: Collection[str], known: Iterable[CoordinatorState]) -> bool:
        """Whether the mission has ended as far as is known here: every coordinator of the team, in this run.

        A coordinator that has not been here yet may still be alive, on any host.
        """
        rows = [row for row in known if (row.agent, row.generation) not in self._earlier]
        ended = {row.agent for row in rows if row.state == "EXITED"}
        return ended.issuperset(coordinators) and all(row.state == "EXITED" for row in rows)

    def restart_blocker(self, agent: str, known: Iterable[CoordinatorState]) -> str:
        """The reason why a coordinator of this host is not started again, '' if it may be."""
        rows = [row for row in known if row.agent == agent]
        if any(record.agent == agent for record in self.parked):
            return "waits for the program and deployment that it belongs to"
        for row in rows:
            if row.state in ("FROZEN", "PREPARED", "IN DOUBT", "MOVED"):
                return f"moved to {row.where}" if row.where else "waits for a host that resumes it"
            if row.state == "RUN":
                return "is restored from the journal"
        last = max(rows, key=lambda row: row.generation, default=None)
        # An earlier start ended in an earlier run: the recorded start was not made.
        if last and self.is_run_open and last.generation >= (self.last_start or 0):
            return f"has ended ({last.outcome}) in the current run; --fresh starts another one"
        return ""


def _outdated_endings(copies: Iterable[CoordinatorRecord]) -> list[CoordinatorRecord]:
    """The terminations of each coordinator except the last few."""
    found: dict[str, list[CoordinatorRecord]] = {}
    for record in copies:
        if record.state == "EXITED":
            found.setdefault(record.agent, []).append(record)
    return [
        record
        for records in found.values()
        for record in sorted(records, key=lambda record: record.generation)[:-MAX_ENDINGS]
    ]


def downtime(times: Mapping[RecordKey, float], clock: Clock, copy: CoordinatorCopy) -> float:
    """The seconds for which a coordinator was only on disk, by the wall clock; 0 without a record.

    `times` has the Unix time at which each record was written.
    """
    written_at = times.get(RecordKey("copy", copy.agent, copy.generation))
    return 0.0 if written_at is None else max(0.0, clock.time() - written_at)


def _generation(effect: Effect) -> int | None:
    """The start whose copy in the machine an effect needs; None for any other effect."""
    match effect:
        case SendTransfer():
            return effect.header.generation
        case CoordinatorStarted() | ResumeCopy() | ResumeWithException() | MarkMigrated() | MarkInDoubt():
            return effect.generation
        case _:
            return None


def _agent(effect: Effect) -> str:
    """The coordinator that an effect is about."""
    match effect:
        case Send():
            return getattr(effect.message, "agent", "")
        case SendTransfer():
            return effect.header.agent
        case LogAnomaly():
            return ""
        case _:
            return effect.agent
