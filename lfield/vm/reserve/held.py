"""What coordinators have reserved: read off the blocks around the place where each stands (decision 53).

An array in a slot of the frame has a member of the team and the number of its reservation, in turn, each
member once and in the order in which all coordinators take. The number is 0 before it is granted, and stays 0
where a block further out has the resource already. A row of the method says which instructions it is about.
Nothing else is kept of a reservation, here or elsewhere in a block.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

from lfield.bytecode.program import RESERVED, Program
from lfield.vm.agent import Agent, Member
from lfield.vm.memory import layout
from lfield.vm.memory.layout import COUNT_LIMIT, FRAME_SLOTS
from lfield.vm.reference.unwind import rows_of


class Entry(NamedTuple):
    """One resource of a `reserve`: its number (0: not granted yet), and the word of the block that has it."""

    resource: Member
    number: int
    word: int


class Held:
    """Looks at the coordinators of one host; changes nothing. `team` is everybody."""

    def __init__(self, program: Program, team: Sequence[Member]) -> None:
        self._program, self._team = program, team

    def of(self, agent: Agent) -> list[tuple[Member, int]]:
        """What a coordinator has: each resource with its number, in the order of the deployment."""
        found: dict[int, tuple[Member, int]] = {}
        for array in self.around(agent):
            for resource, number, _ in self.entries(agent, array):
                if number:
                    found.setdefault(resource.number, (resource, number))
        return [found[at] for at in sorted(found)]

    def number(self, agent: Agent, resource: Member) -> int:
        """The number by which a coordinator has a resource; 0: it has not reserved it."""
        return _number(agent.block.w, self.around(agent), resource)

    def wanted(self, agent: Agent) -> Entry | None:
        """What a coordinator that stands at `take` has to take next; None when it has all."""
        w = agent.block.w
        own, *outer = list(self.around(agent)) or [0]
        numbers = w[own + 2 : own + (w[own] >> 32) : 2].tolist() if own else []
        if 0 not in numbers:
            return None
        waiting = (one for one in self.entries(agent, own, numbers.index(0)) if not one.number)
        return next((one for one in waiting if not _number(w, outer, one.resource)), None)

    def nested(self, agent: Agent) -> bool:
        """Whether a coordinator that stands at `take` has a reservation of a block further out."""
        _, *outer = self.around(agent)
        return any(entry.number for array in outer for entry in self.entries(agent, array))

    def in_order(self, numbers: Collection[int]) -> list[Member]:
        """Members by their numbers, in the order in which everybody takes them: host by host."""
        return sorted((self._team[number] for number in numbers), key=lambda one: (one.host, one.number))

    def around(self, agent: Agent) -> Iterator[int]:
        """The arrays of the blocks around the place where a coordinator stands, innermost first."""
        if not self._program.has_reserves:
            return
        w = agent.block.w
        for frame, row in rows_of(agent.block, self._program, w[layout.W_THREADS]):
            if row.kind == RESERVED and (array := w[frame + FRAME_SLOTS + row.slot]):
                yield array

    def entries(self, agent: Agent, array: int, first: int = 0) -> Iterator[Entry]:
        """What an array has, from the one at `first` on.

        A program that no compiler of ours made may have put anything into it.
        """
        w = agent.block.w
        for word in range(array + 1 + 2 * first, array + (w[array] >> 32) - 1, 2):
            member, number = w[word], w[word + 1]
            known = 0 <= member < len(self._team) and self._team[member].kind == "resource"
            if known and 0 <= number < COUNT_LIMIT:
                yield Entry(self._team[member], number, word + 1)


def _number(w: memoryview[int], arrays: Iterable[int], resource: Member) -> int:
    """The number that some arrays have for a resource, 0 for none. Each call asks this: it is quick."""
    for array in arrays:
        members = w[array + 1 : array + (w[array] >> 32) - 1 : 2].tolist()
        if resource.number in members:
            number: int = w[array + 2 + 2 * members.index(resource.number)]
            if 0 < number < COUNT_LIMIT:
                return number
    return 0
