"""The receiver's half of a hop: every transfer number gets exactly one final verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lfield.replication.transfer.coordinator_copies import MAX_STARTS, CoordinatorCopy, CopyTable
from lfield.replication.transfer.effects import Effect, LogAnomaly, ResumeCopy, Send, TransferRefusal
from lfield.replication.transfer.generations import blocks, stop_reason
from lfield.replication.transfer.transfer_sender import LIMIT, UNREACHABLE
from lfield.wire.coordinator_messages import (
    NEVER_ARRIVED,
    SUPERSEDED,
    CoordinatorState,
    Transfer,
    TransferAccepted,
    TransferQuery,
    TransferRefused,
)
from lfield.wire.fields import truncate

if TYPE_CHECKING:
    from lfield.replication.transfer.termination import Termination
    from lfield.replication.transfer.transfer_sender import TransferSender
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Hello

_NEVER_ARRIVED = TransferRefusal(NEVER_ARRIVED, "the transfer never arrived and is no longer expected")


class InjectHook(Protocol):
    """Loads an arrived copy into the machine, in place of any other copy of that agent."""

    def __call__(self, header: Transfer, block: Buffer) -> TransferRefusal | None:
        """Returns a refusal if the copy cannot be loaded. Copies the block, and makes no call back."""


class TransferReceiver:
    """The hops that end on one host: its arriving copies."""

    def __init__(
        self, own: Hello, copies: CopyTable, departures: TransferSender, termination: Termination
    ) -> None:
        self._own, self._copies, self._departures, self._termination = own, copies, departures, termination
        self._state_id = own.state_id

    def on_transfer(self, host: str, header: Transfer, block: Buffer, inject: InjectHook) -> list[Effect]:
        """Receive a coordinator from `host`."""
        if header.receiver_memory != self._state_id:
            return [self._stale_note(host, header)]
        copy = self._admissible(header, len(block))
        if isinstance(copy, TransferRefusal):
            return [Send(host, _refusal_of(header, copy))]
        effects = self._decide(copy, header, block, inject) if header.sequence > copy.sequence else []
        effects.append(Send(host, _outcome(copy, header)))
        return effects

    def arriving_state(self, header: Transfer) -> CoordinatorState | None:
        """The state reported to other hosts for an arrival that waits for its verdict.

        None when a later state of that start is known, or when the arrival will be refused.
        """
        start = header.agent, header.generation
        copy = self._copies.find(*start)
        is_known = copy is not None and (copy.state != "ABSENT" or copy.sequence >= header.sequence)
        if is_known or start in self._copies.parked or header.receiver_memory != self._state_id:
            return None
        own_host, memory = self._own.host, header.receiver_memory
        return CoordinatorState(
            *start, header.sequence, header.hops, "PREPARED", own_host, receiver_memory=memory
        )

    def on_oversize(self, host: str, header: Transfer, size: int) -> list[Effect]:
        """A coordinator whose block was too large to be read."""
        if header.receiver_memory != self._state_id:
            return [self._stale_note(host, header)]
        found = self._admissible(header, size)
        unfit = found if isinstance(found, TransferRefusal) else self._too_large(header.agent, size)
        return [Send(host, _refusal_of(header, unfit))]

    def on_query(self, host: str, message: TransferQuery) -> list[Effect]:
        """Answer a query about a transfer. A transfer that never arrived is refused permanently, even if it
        arrives later.
        """
        if message.receiver_memory != self._state_id:
            proof = self.prove_outcome(message)
            return [Send(host, proof)] if proof else [self._stale_note(host, message)]
        copy = self._copies.find_or_create(message.agent, message.generation)
        if copy is None:
            return [Send(host, _refusal_of(message, _NEVER_ARRIVED))]
        effects: list[Effect] = []
        if message.sequence > copy.sequence:
            effects = self._confirm_by_successor(copy)
            copy.refuse(message.sequence, _NEVER_ARRIVED)
            effects += self._copies.persist(copy)
        effects.append(Send(host, _outcome(copy, message)))
        return effects

    def prove_outcome(self, query: TransferQuery) -> TransferAccepted | TransferRefused | None:
        """The proof that this host has about a transfer to another host or state id; None without one.

        Only the copy that resulted from the transfer assigns higher numbers of that start.
        """
        copies = self._copies.starts_of(query.agent)
        copy = self._copies.find(query.agent, query.generation)
        if copy is not None and copy.sequence > query.sequence:
            return _outcome(copy, query)
        for other in copies:
            if blocks(other.generation, query.generation, alive=False):
                reason = stop_reason(query.agent, query.generation, other.generation, self._own.host)
                return _refusal_of(query, TransferRefusal(SUPERSEDED, reason))
        return None

    def _decide(
        self, copy: CoordinatorCopy, header: Transfer, block: Buffer, inject: InjectHook
    ) -> list[Effect]:
        """Decide on a new number: the verdict is stored before it is sent."""
        effects = self._inject_block(copy, header, block, inject)
        is_accepted = copy.state == "RUN" and copy.sequence == header.sequence and copy.refusal is None
        effects += self._copies.persist(copy) if self._copies.has_journal else []
        return [*effects, ResumeCopy(copy.agent, copy.generation)] if is_accepted else effects

    def _inject_block(
        self, copy: CoordinatorCopy, header: Transfer, block: Buffer, inject: InjectHook
    ) -> list[Effect]:
        """Sets the verdict in `copy`."""
        effects: list[Effect] = []
        restarted = len(self._copies.starts_of(header.agent)) > 1
        if restarted:
            effects += self._termination.supersede_arrival(copy)
        if copy.state == "EXITED" and copy.outcome != "lost":
            return effects
        if copy.state in ("RUN", "FROZEN"):
            refusal: TransferRefusal | None = TransferRefusal(
                UNREACHABLE, f"{header.agent} is already on {self._own.host}"
            )
        else:
            refusal = inject(header, block)
        if refusal is None:
            copy.mark_running(
                header.sequence, header.hops, bytes(block) if self._copies.has_journal else None
            )
        else:
            effects += self._confirm_by_successor(copy)
            copy.refuse(header.sequence, refusal)
        if restarted:
            effects += self._termination.supersede(header.agent, header.generation, self._own.host)
            effects += self._termination.displace_in_doubt(copy) if refusal is None else []
        return effects

    def _confirm_by_successor(self, copy: CoordinatorCopy) -> list[Effect]:
        """A higher number proves the arrival of a copy that still waits for its verdict."""
        return self._departures.mark_moved(copy) if copy.state == "PREPARED" else []

    def _admissible(self, header: Transfer, size: int) -> CoordinatorCopy | TransferRefusal:
        """The record of that start, or the reason why it can never be admitted here.

        Depends only on constants, so the refusal need not be stored.
        """
        if header.program != self._own.program:
            return TransferRefusal(
                UNREACHABLE,
                f"{header.agent} belongs to program {header.program.hex()[:12]} and {self._own.host} runs "
                f"{self._own.program.hex()[:12]}",
            )
        if size > self._own.max_block:
            return self._too_large(header.agent, size)
        copy = self._copies.find_or_create(header.agent, header.generation)
        if copy is None:
            return TransferRefusal(
                UNREACHABLE,
                f"{self._own.host} knows no coordinator {header.agent}, or over {MAX_STARTS} starts of it",
            )
        if self._copies.parked and (header.agent, header.generation) in self._copies.parked:
            return TransferRefusal(
                UNREACHABLE,
                f"{self._own.host} has another start of {header.agent} under that number, for another "
                f"program: 'lfield forget {header.agent}' ends it",
            )
        return copy

    def _too_large(self, agent: str, size: int) -> TransferRefusal:
        host, maximum = self._own.host, self._own.max_block
        return TransferRefusal(LIMIT, f"{agent} has {size} bytes and {host} takes at most {maximum}")

    def _stale_note(self, host: str, message: Transfer | TransferQuery) -> LogAnomaly:
        # Any answer could be wrong: the verdict of the earlier incarnation is unknown.
        return LogAnomaly(message.agent, host)


def _outcome(copy: CoordinatorCopy, query: Transfer | TransferQuery) -> TransferAccepted | TransferRefused:
    """The verdict on a known number."""
    if copy.outcome == "superseded":
        return _refusal_of(query, TransferRefusal(SUPERSEDED, copy.detail))
    if query.sequence == copy.sequence and copy.refusal is not None:
        return _refusal_of(query, copy.refusal)
    return TransferAccepted(query.agent, query.generation, query.sequence)


def _refusal_of(query: Transfer | TransferQuery, refusal: TransferRefusal) -> TransferRefused:
    return TransferRefused(
        query.agent, query.generation, query.sequence, refusal.kind, truncate(refusal.reason)
    )
