"""What one host remembers of each start of each coordinator: its copy, and its last verdict.

A host with a journal keeps every change of it that others may come to rely on (durability: what is forced to
disk before what).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from lfield.journal.pages import CopyPage
from lfield.mobility.effects import Effect, Persist, Refusal
from lfield.wire.coordinators import Known, Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from lfield.wire.framing import Buffer

#: ABSENT: no copy was ever here, only a transfer that was refused. The rest is `messages.CopyState`.
State = Literal["ABSENT", "RUN", "FROZEN", "PREPARED", "MOVED", "EXITED"]

#: A copy here that runs or may have to run again.
LIVE: tuple[State, ...] = ("RUN", "FROZEN", "PREPARED")

#: Why nobody goes on with a block that is none.
UNREADABLE = "what was kept of it here cannot be read"

#: Most starts of one coordinator that a host remembers; of more it forgets the first that has ended.
MAX_STARTS = 64


@dataclass(slots=True, eq=False)
class Copy:
    """One start of one coordinator, seen from one host; its size does not grow with the hops.

    `sequence` is the highest transfer number that this start used or tried here. `refusal` is set when
    that transfer came from elsewhere and was refused. `target`, `memory` (what the target answers from),
    `deadline` (seconds) and `seal` belong to the departure under way. `block` is what was last sent, or kept:
    the shadow, once the copy is MOVED. `doubt` says why the copy's fate is not known. `restored`: it is here
    from the journal, and has not gone on yet. `unreadable`: the machine has refused the block.
    """

    agent: str
    generation: int
    state: State = "ABSENT"
    sequence: int = 0
    hops: int = 0
    refusal: Refusal | None = None
    target: str = ""
    memory: int = 0
    deadline: float = 0.0
    seal: Callable[[int], Buffer] | None = None
    block: Buffer | None = None
    doubt: str = ""
    outcome: Outcome | Literal[""] = ""
    detail: str = ""
    ended_on: str = ""
    restored: bool = False
    unreadable: bool = False

    @property
    def alive(self) -> bool:
        """Whether this copy, as far as is known, is the coordinator itself."""
        return self.state in LIVE and not self.doubt

    @property
    def is_here(self) -> bool:
        """Whether it is alive and on no way: it runs, or waits to be sent."""
        return self.alive and self.state in ("RUN", "FROZEN")

    def run(self, sequence: int, hops: int) -> None:
        """Become the running copy, whatever was here before."""
        self.state, self.sequence, self.hops = "RUN", sequence, hops
        self.refusal = self.seal = self.block = None
        self.doubt = self.outcome = self.detail = self.ended_on = ""
        self.restored = self.unreadable = False

    def end(self, outcome: Outcome, detail: str, host: str) -> None:
        """Become the memory of an ending."""
        self.state, self.outcome, self.detail, self.ended_on = "EXITED", outcome, detail, host
        self.seal = self.block = None
        self.doubt, self.restored, self.unreadable = "", False, False

    def give_way(self) -> None:
        """Leave the machine in doubt: another start needs its place. The block stays as a shadow."""
        self.state, self.seal, self.restored = "MOVED", None, False
        self.doubt = f"{self.doubt}; its copy here gave way to a later start"

    @property
    def gave_way(self) -> bool:
        """Whether this copy was in doubt when it had to leave the machine, and still is."""
        return self.state == "MOVED" and bool(self.doubt)

    @property
    def is_unanswered(self) -> bool:
        """Whether it was sent, and what became of that is not known."""
        return self.state == "PREPARED" or self.gave_way

    @property
    def awaits_answer(self) -> bool:
        """`is_unanswered`, and in the machine, as what is restored is not before it is woken."""
        return self.is_unanswered and not (self.restored and self.seal is None)

    def known(self) -> Known:
        """What other hosts and `lfield ps` are told."""
        state = "IN DOUBT" if self.doubt else self.state
        assert state != "ABSENT"
        where = {"RUN": "", "EXITED": self.ended_on}.get(state, self.target)
        detail = UNREADABLE if self.unreadable else self.doubt or self.detail
        memory = self.memory if state in ("PREPARED", "IN DOUBT", "MOVED") else 0
        return Known(
            self.agent,
            self.generation,
            self.sequence,
            self.hops,
            state,
            where,
            self.outcome,
            detail,
            memory,
            self.unreadable,
        )

    def page(self, mission: bytes) -> CopyPage:
        """What a journal keeps of it. A copy that waits for a link runs, for whoever reads this later."""
        return CopyPage(
            self.agent,
            self.generation,
            "RUN" if self.state == "FROZEN" else self.state,
            self.sequence,
            self.hops,
            self.refusal.kind if self.refusal else "",
            self.refusal.reason if self.refusal else "",
            self.target,
            self.memory,
            self.outcome,
            self.detail,
            self.ended_on,
            mission,
            bytes(self.block) if self.block is not None else b"",
            self.doubt,
        )

    def restore(self, page: CopyPage) -> None:
        """Become what a page says."""
        self.state = page.state
        self.count(page)
        self.target, self.memory, self.outcome = page.target, page.memory, page.outcome
        self.detail, self.ended_on, self.block = page.detail, page.ended_on, page.block or None
        self.doubt = page.doubt
        self.restored = self.state in ("RUN", "PREPARED")

    def count(self, page: CopyPage) -> None:
        """Take over the verdict that a page has, so that no transfer is decided on anew."""
        self.sequence, self.hops = page.sequence, page.hops
        self.refusal = Refusal(page.kind, page.reason) if page.kind else None


class Copies:
    """All copies of one host, for the coordinators of its deployment and for those that are parked here.

    `mission` is the hash of what their blocks are of (`Hello.mission`), b"" on a host that keeps no journal.
    """

    def __init__(self, agents: Collection[str], mission: bytes = b"") -> None:
        self._starts: dict[str, dict[int, Copy]] = {agent: {} for agent in agents}
        self._mission = mission
        #: Whether this host has a journal.
        self.kept = bool(mission)
        #: The starts whose pages here belong to another mission: nothing but their end is written over them.
        self.parked: dict[tuple[str, int], CopyPage] = {}

    def keep(self, copy: Copy) -> list[Effect]:
        """Have what is known of it on disk before anything that comes after."""
        return self._persist(copy, soon=False) if self.kept or self.parked else []

    def keep_soon(self, copy: Copy) -> list[Effect]:
        """The same, but nothing waits for it: if it is lost, it is asked for again."""
        return self._persist(copy, soon=True) if self.kept or self.parked else []

    def _persist(self, copy: Copy, *, soon: bool) -> list[Effect]:
        start = copy.agent, copy.generation
        parked = self.parked.pop(start, None) if copy.state == "EXITED" else None
        if parked is not None and parked.sequence >= copy.sequence:
            copy.count(parked)
        if not self.kept or start in self.parked:
            return []
        return [Persist(copy.agent, copy.page(self._mission), soon=soon)]

    def __iter__(self) -> Iterator[Copy]:
        return (copy for starts in self._starts.values() for copy in starts.values())

    def of(self, agent: str) -> Collection[Copy]:
        """Every start known of an agent; nothing for a stranger."""
        return self._starts.get(agent, {}).values()

    def find(self, agent: str, generation: int) -> Copy | None:
        """What is known of one start."""
        return self._starts.get(agent, {}).get(generation)

    def enter(self, agent: str, generation: int) -> Copy | None:
        """`find`, with a new entry for a new start; None for a stranger, or when too many have not ended."""
        if self.parked and (agent, generation) in self.parked:
            # Its name may be no coordinator's here: how it ended is remembered all the same.
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
        copy = starts[generation] = Copy(agent, generation)
        return copy
