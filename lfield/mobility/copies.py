"""What one host remembers of each start of each coordinator: its copy, and its last verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from lfield.wire.messages import Known, Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from lfield.mobility.effects import Refusal
    from lfield.wire.framing import Buffer

#: ABSENT: no copy was ever here, only a transfer that was refused. The rest is `messages.CopyState`.
State = Literal["ABSENT", "RUN", "FROZEN", "PREPARED", "MOVED", "EXITED"]

#: A copy here that runs or may have to run again.
LIVE: tuple[State, ...] = ("RUN", "FROZEN", "PREPARED")

#: Most starts of one coordinator that a host remembers. Every restart of its home host makes one.
MAX_STARTS = 64


@dataclass(slots=True, eq=False)
class Copy:
    """One start of one coordinator, seen from one host; its size does not grow with the hops.

    `sequence` is the highest transfer number that this start used or tried here. `refusal` is set when
    that transfer came from elsewhere and was refused. `target`, `incarnation` (of the target when the
    block was sent), `deadline` (seconds) and `seal` belong to the departure under way. `block` is what was
    last sent: the shadow, once the copy is MOVED. `doubt` says why the copy's fate is not known.
    """

    agent: str
    generation: int
    state: State = "ABSENT"
    sequence: int = 0
    hops: int = 0
    refusal: Refusal | None = None
    target: str = ""
    incarnation: int = 0
    deadline: float = 0.0
    seal: Callable[[int], Buffer] | None = None
    block: Buffer | None = None
    doubt: str = ""
    outcome: Outcome | Literal[""] = ""
    detail: str = ""
    ended_on: str = ""

    @property
    def alive(self) -> bool:
        """Whether this copy, as far as is known, is the coordinator itself."""
        return self.state in LIVE and not self.doubt

    def run(self, sequence: int, hops: int) -> None:
        """Become the running copy, whatever was here before."""
        self.state, self.sequence, self.hops = "RUN", sequence, hops
        self.refusal = self.seal = self.block = None
        self.doubt = self.outcome = self.detail = self.ended_on = ""

    def end(self, outcome: Outcome, detail: str, host: str) -> None:
        """Become the memory of an ending."""
        self.state, self.outcome, self.detail, self.ended_on = "EXITED", outcome, detail, host
        self.seal = self.block = None
        self.doubt = ""

    def give_way(self) -> None:
        """Leave the machine in doubt: another start needs its place. The block stays as a shadow."""
        self.state, self.seal = "MOVED", None
        self.doubt = f"{self.doubt}; its copy here gave way to a later start"

    @property
    def gave_way(self) -> bool:
        """Whether this copy was in doubt when it had to leave the machine, and still is."""
        return self.state == "MOVED" and bool(self.doubt)

    def known(self) -> Known:
        """What other hosts and `lfield ps` are told."""
        state = "IN DOUBT" if self.doubt else self.state
        assert state != "ABSENT"
        where = {"RUN": "", "EXITED": self.ended_on}.get(state, self.target)
        detail = self.doubt or self.detail
        life = self.incarnation if state in ("PREPARED", "IN DOUBT", "MOVED") else 0
        return Known(
            self.agent, self.generation, self.sequence, self.hops, state, where, self.outcome, detail, life
        )


class Copies:
    """All copies of one host, for the coordinators of its deployment and for no others."""

    def __init__(self, agents: Collection[str]) -> None:
        self._starts: dict[str, dict[int, Copy]] = {agent: {} for agent in agents}

    def __iter__(self) -> Iterator[Copy]:
        return (copy for starts in self._starts.values() for copy in starts.values())

    def of(self, agent: str) -> Collection[Copy]:
        """Every start known of an agent; nothing for a stranger."""
        return self._starts.get(agent, {}).values()

    def find(self, agent: str, generation: int) -> Copy | None:
        """What is known of one start."""
        return self._starts.get(agent, {}).get(generation)

    def enter(self, agent: str, generation: int) -> Copy | None:
        """`find`, with a new entry for a new start; None for a stranger, or when there are too many."""
        starts = self._starts.get(agent)
        if starts is None:
            return None
        copy = starts.get(generation)
        if copy is None and len(starts) < MAX_STARTS:
            copy = starts[generation] = Copy(agent, generation)
        return copy
