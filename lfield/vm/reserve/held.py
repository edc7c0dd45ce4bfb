"""What coordinators have reserved: read off the blocks around the place where each stands (decision 53).

An array in a slot of the frame has a member of the team and the number of its reservation, in turn, each
member once and in the order in which all coordinators take. The number is 0 before it is granted, and stays 0
where a block further out has the resource already. A row of the method says which instructions it is about.
Nothing else is kept of a reservation, here or elsewhere in a block.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
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
        return next((number for held, number in self.of(agent) if held is resource), 0)

    def wanted(self, agent: Agent) -> Entry | None:
        """What a coordinator that stands at `take` has to take next; None when it has all."""
        has = {resource.number for resource, _ in self.of(agent)}
        own = next(self.around(agent), 0)
        waiting = (one for one in self.entries(agent, own) if not one.number) if own else iter(())
        return next((one for one in waiting if one.resource.number not in has), None)

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

    def entries(self, agent: Agent, array: int) -> Iterator[Entry]:
        """What an array has. A program that no compiler of ours made may have put anything into it."""
        w = agent.block.w
        for word in range(array + 1, array + (w[array] >> 32) - 1, 2):
            member, number = w[word], w[word + 1]
            known = 0 <= member < len(self._team) and self._team[member].kind == "resource"
            if known and 0 <= number < COUNT_LIMIT:
                yield Entry(self._team[member], number, word + 1)
