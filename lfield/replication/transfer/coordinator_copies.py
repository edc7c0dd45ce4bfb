"""Records of one host about each start of each coordinator: its copy, and the last verdict on a transfer.

A host with a journal writes every change that other hosts may rely on before it sends a message about it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from msgspec import Struct

from lfield.journal.records import CoordinatorRecord
from lfield.replication.transfer.effects import Effect, PersistRecord, TransferRefusal
from lfield.wire.coordinator_messages import CoordinatorState, Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from lfield.wire.framing import Buffer

#: The states of a copy. ABSENT: there was never a copy here, only a refused transfer. The other states are
#: those of `CopyState`.
CopyPhase = Literal["ABSENT", "RUN", "FROZEN", "PREPARED", "MOVED", "EXITED"]

#: States of a copy here that runs or may have to run again.
LIVE_STATES: tuple[CopyPhase, ...] = ("RUN", "FROZEN", "PREPARED")

#: The reason why a copy with an unreadable block cannot be resumed.
UNREADABLE = "its stored copy here cannot be read"

#: The most starts of one coordinator that a host records; the first ended one is dropped for a new one.
MAX_STARTS = 64


class CoordinatorCopy(Struct, eq=False):
    """One start of one coordinator, as known to one host; its size does not grow with the number of hops.

    `sequence` is the highest transfer number that this start used or tried here. `refusal` is set when that
    transfer came from another host and was refused. `target`, `receiver_memory` (the id of the target's
    journal or process), `deadline` (seconds) and `make_block` belong to the departure under way. `block` is
    the block last sent or stored: the shadow, once the copy is MOVED. `doubt_reason` is the reason why the
    state of the copy is unknown. `is_restored`: the copy is from the journal and has not continued yet.
    `is_unreadable`: the machine has refused the block.
    """

    agent: str
    generation: int
    state: CopyPhase = "ABSENT"
    sequence: int = 0
    hops: int = 0
    refusal: TransferRefusal | None = None
    target: str = ""
    receiver_memory: int = 0
    deadline: float = 0.0
    make_block: Callable[[int], Buffer] | None = None
    block: Buffer | None = None
    doubt_reason: str = ""
    outcome: Outcome | Literal[""] = ""
    detail: str = ""
    ended_on: str = ""
    is_restored: bool = False
    is_unreadable: bool = False

    @property
    def is_alive(self) -> bool:
        """Whether this copy, as far as is known, is the coordinator itself."""
        return self.state in LIVE_STATES and not self.doubt_reason

    @property
    def is_here(self) -> bool:
        """Whether the copy is alive and not in transit: it runs, or waits to be sent."""
        return self.is_alive and self.state in ("RUN", "FROZEN")

    def mark_running(self, sequence: int, hops: int, block: Buffer | None = None) -> None:
        """Become the running copy, replacing any earlier state; `block` is its stored image."""
        self.state, self.sequence, self.hops, self.block = "RUN", sequence, hops, block
        self.refusal = self.make_block = None
        self.doubt_reason = self.outcome = self.detail = self.ended_on = ""
        self.is_restored = self.is_unreadable = False

    def save(self, block: bytes) -> None:
        """The running copy is stored at a portal call of this host."""
        self.block, self.is_restored = block, False

    def freeze(self, target: str, make_block: Callable[[int], Buffer], deadline: float) -> None:
        """RUN to FROZEN: wait to leave for `target`."""
        self.state, self.target, self.make_block, self.deadline = "FROZEN", target, make_block, deadline

    def prepare(self, block: Buffer, memory: int) -> None:
        """FROZEN to PREPARED: `block` leaves under the next number for `memory` of the target."""
        self.sequence += 1
        self.state, self.block, self.receiver_memory, self.refusal = "PREPARED", block, memory, None

    def return_to_frozen(self) -> None:
        """PREPARED to FROZEN: the transfer never arrived and never will."""
        self.state = "FROZEN"

    def move(self) -> None:
        """PREPARED to MOVED: the coordinator is on another host, and the block is kept as its shadow."""
        self.state, self.make_block, self.doubt_reason, self.is_restored = "MOVED", None, "", False

    def resume(self, *, is_stored: bool) -> None:
        """FROZEN or PREPARED to RUN: the copy continues here; `is_stored` keeps the block."""
        self.state, self.make_block = "RUN", None
        if not is_stored:
            self.block = None

    def halt(self, reason: str) -> None:
        """Stop in doubt, as if stored at its present position: a later start may continue from the block."""
        self.state, self.make_block, self.is_restored = "RUN", None, False
        self.target, self.receiver_memory, self.doubt_reason = "", 0, reason

    def refuse(self, sequence: int, refusal: TransferRefusal) -> None:
        """A transfer with this number from another host was refused."""
        self.sequence, self.refusal = sequence, refusal

    def postpone(self, deadline: float) -> None:
        """Extend the deadline of the departure to this time, in seconds."""
        self.deadline = deadline

    def mark_in_doubt(self, reason: str) -> None:
        """Record that the state of this copy is not known."""
        self.doubt_reason = reason

    def clear_doubt(self) -> None:
        """Record that the state of this copy is known."""
        self.doubt_reason = ""

    def mark_unreadable(self) -> None:
        """The machine has refused the block."""
        self.is_unreadable = True

    def reload(self, make_block: Callable[[int], Buffer] | None) -> None:
        """A restored copy is in the machine again; without `make_block` its block was refused."""
        self.make_block = make_block
        if make_block is None:
            self.mark_in_doubt(UNREADABLE)
            self.mark_unreadable()

    def mark_continued(self) -> None:
        """Record that the copy has continued since it was restored."""
        self.is_restored = False

    def mark_ended(self, outcome: Outcome, detail: str, host: str) -> None:
        """Become the record of a termination."""
        self.state, self.outcome, self.detail, self.ended_on = "EXITED", outcome, detail, host
        self.make_block = self.block = None
        self.doubt_reason, self.is_restored, self.is_unreadable = "", False, False

    def displace(self) -> None:
        """Leave the machine in doubt, to make room for another start. The block is kept as a shadow."""
        self.state, self.make_block, self.is_restored = "MOVED", None, False
        self.doubt_reason = f"{self.doubt_reason}; its copy here was displaced by a later start"

    @property
    def is_displaced(self) -> bool:
        """Whether this copy was in doubt when it was displaced from the machine, and still is in doubt."""
        return self.state == "MOVED" and bool(self.doubt_reason)

    @property
    def is_unanswered(self) -> bool:
        """Whether the copy was sent, and the verdict is unknown."""
        return self.state == "PREPARED" or self.is_displaced

    @property
    def awaits_answer(self) -> bool:
        """`is_unanswered`, and in the machine: a restored copy is not in the machine before it is loaded."""
        return self.is_unanswered and not (self.is_restored and self.make_block is None)

    def state_message(self) -> CoordinatorState:
        """The state that is sent to other hosts and `lfield ps`."""
        state = "IN DOUBT" if self.doubt_reason else self.state
        assert state != "ABSENT"
        where = {"RUN": "", "EXITED": self.ended_on}.get(state, self.target)
        detail = UNREADABLE if self.is_unreadable else self.doubt_reason or self.detail
        memory = self.receiver_memory if state in ("PREPARED", "IN DOUBT", "MOVED") else 0
        return CoordinatorState(
            self.agent,
            self.generation,
            self.sequence,
            self.hops,
            state,
            where,
            self.outcome,
            detail,
            memory,
            self.is_unreadable,
        )

    def record(self, mission: bytes) -> CoordinatorRecord:
        """The journal record. A copy that waits for a link is recorded as running."""
        return CoordinatorRecord(
            self.agent,
            self.generation,
            "RUN" if self.state == "FROZEN" else self.state,
            self.sequence,
            self.hops,
            self.refusal.kind if self.refusal else "",
            self.refusal.reason if self.refusal else "",
            self.target,
            self.receiver_memory,
            self.outcome,
            self.detail,
            self.ended_on,
            mission,
            bytes(self.block) if self.block is not None else b"",
            self.doubt_reason,
        )

    def restore(self, record: CoordinatorRecord) -> None:
        """Restore the state in a record."""
        self.state = record.state
        self.adopt_verdict(record)
        self.target, self.receiver_memory, self.outcome = (
            record.target,
            record.receiver_memory,
            record.outcome,
        )
        self.detail, self.ended_on, self.block = record.detail, record.ended_on, record.block or None
        self.doubt_reason = record.doubt
        self.is_restored = self.state in ("RUN", "PREPARED")

    def adopt_verdict(self, record: CoordinatorRecord) -> None:
        """Adopt the verdict in a record, so that no transfer is decided twice."""
        self.sequence, self.hops = record.sequence, record.hops
        self.refusal = TransferRefusal(record.kind, record.reason) if record.kind else None


class CopyTable:
    """All copies of one host: of the coordinators of its deployment, and of parked ones.

    `mission` is the hash of their mission (`Hello.mission_hash`), b"" on a host without a journal.
    """

    def __init__(self, agents: Collection[str], mission: bytes = b"") -> None:
        self._starts: dict[str, dict[int, CoordinatorCopy]] = {agent: {} for agent in agents}
        self._mission = mission
        #: Whether this host has a journal.
        self.has_journal = bool(mission)
        #: The starts whose records belong to another mission: only their termination may overwrite these.
        self.parked: dict[tuple[str, int], CoordinatorRecord] = {}

    def park(self, records: Iterable[CoordinatorRecord]) -> None:
        """Set the records of other missions."""
        self.parked = {(record.agent, record.generation): record for record in records}

    def persist(self, copy: CoordinatorCopy, *, is_lazy: bool = False) -> list[Effect]:
        """Write the record of a copy before later effects.

        No effect waits for a lazy write: its contents can be requested again from other hosts.
        """
        if not (self.has_journal or self.parked):
            return []
        start = copy.agent, copy.generation
        parked = self.parked.pop(start, None) if copy.state == "EXITED" else None
        if parked is not None and parked.sequence >= copy.sequence:
            copy.adopt_verdict(parked)
        if not self.has_journal or start in self.parked:
            return []
        return [PersistRecord(copy.agent, copy.record(self._mission), is_lazy=is_lazy)]

    def parked_states(self) -> list[CoordinatorState]:
        """The states of parked copies, for other hosts."""
        return [
            CoordinatorState(
                record.agent,
                record.generation,
                record.sequence,
                record.hops,
                "MOVED" if record.state == "MOVED" else "PARKED",
                record.target if record.state == "MOVED" else "",
            )
            for record in self.parked.values()
        ]

    def __iter__(self) -> Iterator[CoordinatorCopy]:
        return (copy for starts in self._starts.values() for copy in starts.values())

    def starts_of(self, agent: str) -> Collection[CoordinatorCopy]:
        """Every known start of an agent; empty for an unknown agent."""
        return self._starts.get(agent, {}).values()

    def find(self, agent: str, generation: int) -> CoordinatorCopy | None:
        """The record of one start."""
        return self._starts.get(agent, {}).get(generation)

    def find_or_create(self, agent: str, generation: int) -> CoordinatorCopy | None:
        """`find`, with a new entry for a new start; None for an unknown agent, or if too many starts are
        alive."""
        if self.parked and (agent, generation) in self.parked:
            # The agent may not be a coordinator of this deployment: its termination is recorded nevertheless.
            self._starts.setdefault(agent, {})
        starts = self._starts.get(agent)
        if starts is None:
            return None
        copy = starts.get(generation)
        if copy is not None:
            return copy
        if len(starts) >= MAX_STARTS:
            ended = min((g for g, c in starts.items() if c.state == "EXITED"), default=None)
            if ended is None or ended > generation:
                return None
            del starts[ended]
        copy = starts[generation] = CoordinatorCopy(agent, generation)
        return copy
