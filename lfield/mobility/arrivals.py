"""The receiver's half of a hop: every transfer number gets one verdict, and keeps it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.mobility.copies import MAX_STARTS, Copies, Copy
from lfield.mobility.departures import LIMIT, UNREACHABLE
from lfield.mobility.effects import Effect, Go, Note, Refusal, Send
from lfield.mobility.generations import stops, why_stopped
from lfield.wire.coordinators import NEVER_ARRIVED, SUPERSEDED, Accepted, Inquire, Known, Refused, Transfer
from lfield.wire.fields import clip

if TYPE_CHECKING:
    from collections.abc import Callable

    from lfield.mobility.departures import Departures
    from lfield.mobility.endings import Endings
    from lfield.wire.framing import Buffer
    from lfield.wire.messages import Hello

_NEVER_ARRIVED = Refusal(NEVER_ARRIVED, "the transfer never arrived and is no longer expected")


class Arrivals:
    """The copies that come to one host."""

    def __init__(
        self,
        own: Hello,
        copies: Copies,
        departures: Departures,
        endings: Endings,
        inject: Callable[[Transfer, Buffer], Refusal | None],
    ) -> None:
        self._own, self._copies, self._departures, self._endings = own, copies, departures, endings
        self._memory, self._inject = own.remembers, inject

    def arrive(self, host: str, header: Transfer, block: Buffer) -> list[Effect]:
        """A coordinator has arrived from `host`."""
        if header.receiver_memory != self._memory:
            return [self._late(host, header)]
        copy = self._fit(header, len(block))
        if isinstance(copy, Refusal):
            return [Send(host, _refused(header, copy))]
        effects = self._decide(copy, header, block) if header.sequence > copy.sequence else []
        effects.append(Send(host, _verdict(copy, header)))
        return effects

    def arriving(self, header: Transfer) -> Known | None:
        """What others are told of a coordinator that has come, and waits for its verdict.

        None when more is known of that start, or it will not be taken.
        """
        start = header.agent, header.generation
        copy = self._copies.find(*start)
        seen = copy is not None and (copy.state != "ABSENT" or copy.sequence >= header.sequence)
        if seen or start in self._copies.parked or header.receiver_memory != self._memory:
            return None
        here, memory = self._own.host, header.receiver_memory
        return Known(*start, header.sequence, header.hops, "PREPARED", here, receiver_memory=memory)

    def oversize(self, host: str, header: Transfer, size: int) -> list[Effect]:
        """A coordinator whose block was too large to be read."""
        if header.receiver_memory != self._memory:
            return [self._late(host, header)]
        found = self._fit(header, size)
        unfit = found if isinstance(found, Refusal) else self._too_large(header.agent, size)
        return [Send(host, _refused(header, unfit))]

    def inquire(self, host: str, message: Inquire) -> list[Effect]:
        """What became of a transfer? One that was never seen is refused for good, should it still come."""
        if message.receiver_memory != self._memory:
            proof = self.vouch(message)
            return [Send(host, proof)] if proof else [self._late(host, message)]
        copy = self._copies.enter(message.agent, message.generation)
        if copy is None:
            return [Send(host, _refused(message, _NEVER_ARRIVED))]
        effects: list[Effect] = []
        if message.sequence > copy.sequence:
            effects = self._outrun(copy)
            copy.sequence, copy.refusal = message.sequence, _NEVER_ARRIVED
            effects += self._copies.keep(copy)
        effects.append(Send(host, _verdict(copy, message)))
        return effects

    def vouch(self, asked: Inquire) -> Accepted | Refused | None:
        """What this host can prove about a transfer to another host or memory; None for nothing.

        A higher number of that start is given out only by the copy that the transfer became.
        """
        copies = self._copies.of(asked.agent)
        copy = self._copies.find(asked.agent, asked.generation)
        if copy is not None and copy.sequence > asked.sequence:
            return _verdict(copy, asked)
        for other in copies:
            if stops(other.generation, asked.generation, alive=False):
                reason = why_stopped(asked.agent, asked.generation, other.generation, self._own.host)
                return _refused(asked, Refusal(SUPERSEDED, reason))
        return None

    def _decide(self, copy: Copy, header: Transfer, block: Buffer) -> list[Effect]:
        """Decide on a number not seen before: the verdict is kept before anybody hears of it."""
        effects = self._take(copy, header, block)
        taken = copy.state == "RUN" and copy.sequence == header.sequence and copy.refusal is None
        if taken and self._copies.kept:
            copy.block = bytes(block)
        effects += self._copies.keep(copy)
        return [*effects, Go(copy.agent, copy.generation)] if taken else effects

    def _take(self, copy: Copy, header: Transfer, block: Buffer) -> list[Effect]:
        """The verdict is in `copy` afterwards."""
        effects: list[Effect] = []
        restarted = len(self._copies.of(header.agent)) > 1
        if restarted:
            effects += self._endings.yields(copy)
        if copy.state == "EXITED" and copy.outcome != "lost":
            return effects
        if copy.state in ("RUN", "FROZEN"):
            refusal: Refusal | None = Refusal(UNREACHABLE, f"{header.agent} is already on {self._own.host}")
        else:
            refusal = self._inject(header, block)
        if refusal is None:
            copy.run(header.sequence, header.hops)
        else:
            effects += self._outrun(copy)
            copy.sequence, copy.refusal = header.sequence, refusal
        if restarted:
            effects += self._endings.supersede(header.agent, header.generation, self._own.host)
            effects += self._endings.replaced(copy) if refusal is None else []
        return effects

    def _outrun(self, copy: Copy) -> list[Effect]:
        """A higher number proves that a copy still waiting for its verdict has arrived."""
        return self._departures.moved(copy) if copy.state == "PREPARED" else []

    def _fit(self, header: Transfer, size: int) -> Copy | Refusal:
        """What is known of that start, or why it can never be taken here.

        That depends on nothing that changes, so it needs no memory.
        """
        if header.program != self._own.program:
            return Refusal(
                UNREACHABLE,
                f"{header.agent} belongs to program {header.program.hex()[:12]} and {self._own.host} runs "
                f"{self._own.program.hex()[:12]}",
            )
        if size > self._own.max_block:
            return self._too_large(header.agent, size)
        copy = self._copies.enter(header.agent, header.generation)
        if copy is None:
            return Refusal(
                UNREACHABLE,
                f"{self._own.host} knows no coordinator {header.agent}, or over {MAX_STARTS} starts of it",
            )
        if self._copies.parked and (header.agent, header.generation) in self._copies.parked:
            return Refusal(
                UNREACHABLE,
                f"{self._own.host} keeps another start of {header.agent} under that number, for another "
                f"program: 'lfield forget {header.agent}' ends it",
            )
        return copy

    def _too_large(self, agent: str, size: int) -> Refusal:
        host, most = self._own.host, self._own.max_block
        return Refusal(LIMIT, f"{agent} has {size} bytes and {host} takes at most {most}")

    def _late(self, host: str, message: Transfer | Inquire) -> Note:
        # Any answer could be wrong: what the earlier life of this host did with it is not known.
        return Note(f"{host} sent {message.agent} or asked for it in an earlier life of {self._own.host}")


def _verdict(copy: Copy, asked: Transfer | Inquire) -> Accepted | Refused:
    """What was decided on a number that has been seen."""
    if copy.outcome == "superseded":
        return _refused(asked, Refusal(SUPERSEDED, copy.detail))
    if asked.sequence == copy.sequence and copy.refusal is not None:
        return _refused(asked, copy.refusal)
    return Accepted(asked.agent, asked.generation, asked.sequence)


def _refused(asked: Transfer | Inquire, refusal: Refusal) -> Refused:
    return Refused(asked.agent, asked.generation, asked.sequence, refusal.kind, clip(refusal.reason))
