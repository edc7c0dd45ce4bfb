"""Going on from what was kept of a coordinator whose holder is gone for good (durability.md, section 3).

Somebody declares that: a person (`lfield recover`), or a majority of hosts. From the newest block that this
host has, a new start goes on at its portal call, with `RestartException` thrown there. Earlier starts end,
wherever a host hears of the recovery. Before a majority does so, it has them barred (decision 45).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.mobility.copies import Copies, Copy
from lfield.mobility.departures import PERHAPS, RESTARTED
from lfield.mobility.effects import Began, Effect, Resume, Supersede
from lfield.wire.coordinators import TERMINAL

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from lfield.mobility.endings import Endings
    from lfield.wire.framing import Buffer


class Recoveries:
    """What one host, `host`, may go on with although it is not the holder."""

    def __init__(self, host: str, copies: Copies, endings: Endings) -> None:
        self._host, self._copies, self._endings = host, copies, endings

    def newest(self, agent: str) -> Copy | None:
        """What is left here of a coordinator: its newest shadow, or a copy that has not gone on since it was
        kept, or may not; None without any, or when it runs here.
        """
        copies = self._copies.of(agent)
        runs = any(copy.is_here and not copy.restored for copy in copies)
        return None if runs else newest(copies)

    def recover(
        self, agent: str, generation: int, put: Callable[[Copy], Callable[[int], Buffer] | None]
    ) -> list[Effect]:
        """See `Mobility.recover`.

        Raises ValueError when nothing is left here, or that number is known.
        """
        left = self.newest(agent)
        if left is None or self._copies.find(agent, generation) is not None:
            raise ValueError(f"{agent} cannot be recovered as generation {generation}")
        found = Copy(agent, generation, hops=left.hops, block=left.block and bytes(left.block))
        if found.block is not None and put(found) is None:
            left.unreadable = True
            return []
        copy = self._copies.enter(agent, generation)
        assert copy is not None
        copy.run(0, left.hops)
        copy.block = found.block
        # Nobody is told, and nothing begins, before the new start is on the disk.
        effects = self._copies.keep(copy) + self._endings.outranked(copy)
        if found.block is None:
            return [*effects, Began(agent, generation)]
        left_for = f"where it left for {left.target}" if left.target else "where it was kept"
        known = f"{PERHAPS}, and what came after it is not known"
        reason = f"{agent} was recovered on {self._host} from {left_for}; {known}"
        return [*effects, Resume(agent, generation, 0, RESTARTED, reason, recovered=True)]


def bar(copies: Collection[Copy], generation: int, reason: str) -> list[Effect]:
    """Stop what is here of every start before `generation`.

    Nothing has ended by that: what was last kept is as good as a shadow, until a later start goes on.
    """
    effects: list[Effect] = []
    for copy in copies:
        if copy.generation < generation and copy.is_here:
            copy.state, copy.seal, copy.restored = "RUN", None, False
            copy.target, copy.memory = "", 0
            copy.doubt = f"no start of it before number {generation} may run any more: {reason}"
            effects.append(Supersede(copy.agent, copy.generation, copy.doubt))
    return effects


def newest(copies: Collection[Copy]) -> Copy | None:
    """The copy that a coordinator could go on from; None when nothing is here, or a later start has ended."""
    ended = max((copy.generation for copy in copies if copy.outcome in TERMINAL), default=0)
    here = (copy for copy in copies if copy.state not in ("ABSENT", "EXITED") and copy.generation > ended)
    return max(here, key=lambda copy: copy.generation, default=None)


def termination(copies: Collection[Copy]) -> Copy | None:
    """The newest start that has terminated; None without one, or when a later one is left here."""
    if newest(copies) is not None:
        return None
    ended = (copy for copy in copies if copy.outcome in TERMINAL)
    return max(ended, key=lambda copy: copy.generation, default=None)
