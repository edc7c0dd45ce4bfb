"""Recovery of a coordinator whose holder is lost, from a stored copy (durability.md, section 3).

An operator (`lfield recover`) or a majority of hosts declares the loss. A new start resumes from the newest
block on this host at its portal call, with `RestartException` thrown there. Earlier starts end as soon as a
host receives a record of the recovery; a majority fences them in advance (decision 45).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.replication.transfer.coordinator_copies import CoordinatorCopy, CopyTable
from lfield.replication.transfer.effects import CoordinatorStarted, Effect, ResumeWithException, TerminateCopy
from lfield.replication.transfer.transfer_sender import MAYBE_STARTED, RESTARTED
from lfield.wire.coordinator_messages import TERMINAL

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from lfield.replication.transfer.termination import Termination
    from lfield.wire.framing import Buffer


class CopyRecovery:
    """The copies from which `host` may resume coordinators that it does not hold."""

    def __init__(self, host: str, copies: CopyTable, termination: Termination) -> None:
        self._host, self._copies, self._termination = host, copies, termination

    def newest_copy(self, agent: str) -> CoordinatorCopy | None:
        """The newest shadow, or a stored copy that has not continued or may not continue; None if there is
        none, or if the coordinator runs here.
        """
        copies = self._copies.starts_of(agent)
        runs = any(copy.is_here and not copy.is_restored for copy in copies)
        return None if runs else newest_resumable(copies)

    def recover(
        self, agent: str, generation: int, put: Callable[[CoordinatorCopy], Callable[[int], Buffer] | None]
    ) -> list[Effect]:
        """See `Mobility.recover`.

        Raises ValueError if there is no copy here, or if the number is known.
        """
        newest = self.newest_copy(agent)
        if newest is None or self._copies.find(agent, generation) is not None:
            raise ValueError(f"{agent} cannot be recovered as generation {generation}")
        recovered = CoordinatorCopy(
            agent, generation, hops=newest.hops, block=newest.block and bytes(newest.block)
        )
        if recovered.block is not None and put(recovered) is None:
            newest.mark_unreadable()
            return []
        copy = self._copies.find_or_create(agent, generation)
        assert copy is not None
        copy.mark_running(0, newest.hops, recovered.block)
        # No message is sent, and no copy starts, before the record of the new start is on disk.
        effects = self._copies.persist(copy) + self._termination.terminate_outranked(copy)
        if recovered.block is None:
            return [*effects, CoordinatorStarted(agent, generation)]
        left_for = f"its departure for {newest.target}" if newest.target else "its last stored state"
        known = f"{MAYBE_STARTED}, and later actions are unknown"
        reason = f"{agent} was recovered on {self._host} from {left_for}; {known}"
        return [*effects, ResumeWithException(agent, generation, 0, RESTARTED, reason, recovered=True)]


def stop_below(copies: Collection[CoordinatorCopy], generation: int, reason: str) -> list[Effect]:
    """Stop every copy here of a start before `generation`.

    The stopped copies have not terminated: a later start may resume from the stored block, as from a shadow.
    """
    effects: list[Effect] = []
    for copy in copies:
        if copy.generation < generation and copy.is_here:
            copy.halt(f"starts before number {generation} are fenced: {reason}")
            effects.append(TerminateCopy(copy.agent, copy.generation, copy.doubt_reason))
    return effects


def newest_resumable(copies: Collection[CoordinatorCopy]) -> CoordinatorCopy | None:
    """The copy from which a coordinator could resume; None if there is none, or a later start has ended."""
    ended = max((copy.generation for copy in copies if copy.outcome in TERMINAL), default=0)
    candidates = (
        copy for copy in copies if copy.state not in ("ABSENT", "EXITED") and copy.generation > ended
    )
    return max(candidates, key=lambda copy: copy.generation, default=None)


def termination(copies: Collection[CoordinatorCopy]) -> CoordinatorCopy | None:
    """The newest terminated start; None if there is none, or if a later start is here."""
    if newest_resumable(copies) is not None:
        return None
    ended = (copy for copy in copies if copy.outcome in TERMINAL)
    return max(ended, key=lambda copy: copy.generation, default=None)
