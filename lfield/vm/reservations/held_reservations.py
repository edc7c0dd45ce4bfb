"""Reservations of coordinators, read from the blocks around their positions (decision 53).

An array in a slot of the frame alternates members of the team and reservation numbers, each member once, in
the global order of acquisition. The number is 0 before the grant, and stays 0 if an outer block has the
resource. A row of the method gives the covered instructions. There is no other record of a reservation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

from lfield.bytecode.program import RESERVED, Program
from lfield.vm.agent import Agent, TeamMember
from lfield.vm.memory import layout
from lfield.vm.memory.layout import COUNT_LIMIT, FRAME_SLOTS
from lfield.vm.reference.unwinder import rows_of


class ReservationEntry(NamedTuple):
    """One resource of a `reserve`: its number (0: not granted), and the word of the block that contains the
    number.
    """

    resource: TeamMember
    number: int
    word: int


class HeldReservations:
    """Reads the reservations of coordinators of one host. `team` has all agents."""

    def __init__(self, program: Program, team: Sequence[TeamMember]) -> None:
        self._program, self._team = program, team

    def of_coordinator(self, agent: Agent) -> list[tuple[TeamMember, int]]:
        """The resources of a coordinator with their numbers, in the order of the deployment."""
        found: dict[int, tuple[TeamMember, int]] = {}
        for array in self.enclosing_arrays(agent):
            for resource, number, _ in self.entries(agent, array):
                if number:
                    found.setdefault(resource.number, (resource, number))
        return [found[at] for at in sorted(found)]

    def reservation_number(self, agent: Agent, resource: TeamMember) -> int:
        """The number by which a coordinator has a resource; 0 for none."""
        return _number(agent.block.w, self.enclosing_arrays(agent), resource)

    def next_ungranted(self, agent: Agent) -> ReservationEntry | None:
        """The next resource to acquire for a coordinator at `take`; None if it has all."""
        w = agent.block.w
        own, *outer = list(self.enclosing_arrays(agent)) or [0]
        numbers = w[own + 2 : own + (w[own] >> 32) : 2].tolist() if own else []
        if 0 not in numbers:
            return None
        waiting = (entry for entry in self.entries(agent, own, numbers.index(0)) if not entry.number)
        return next((entry for entry in waiting if not _number(w, outer, entry.resource)), None)

    def is_nested(self, agent: Agent) -> bool:
        """Whether a coordinator at `take` has a reservation of an outer block."""
        _, *outer = self.enclosing_arrays(agent)
        return any(entry.number for array in outer for entry in self.entries(agent, array))

    def in_order(self, numbers: Collection[int]) -> list[TeamMember]:
        """Members by number in the global order of acquisition: host by host."""
        return sorted(
            (self._team[number] for number in numbers), key=lambda member: (member.host, member.number)
        )

    def enclosing_arrays(self, agent: Agent) -> Iterator[int]:
        """The arrays of the blocks around the position of a coordinator, innermost first."""
        if not self._program.has_reserves:
            return
        w = agent.block.w
        for frame, row in rows_of(agent.block, self._program, w[layout.W_THREADS]):
            if row.kind == RESERVED and (array := w[frame + FRAME_SLOTS + row.slot]):
                yield array

    def entries(self, agent: Agent, array: int, first: int = 0) -> Iterator[ReservationEntry]:
        """The entries of an array, from the entry at `first` on.

        A program of a foreign compiler may have arbitrary content in it.
        """
        w = agent.block.w
        for word in range(array + 1 + 2 * first, array + (w[array] >> 32) - 1, 2):
            member, number = w[word], w[word + 1]
            known = 0 <= member < len(self._team) and self._team[member].kind == "resource"
            if known and 0 <= number < COUNT_LIMIT:
                yield ReservationEntry(self._team[member], number, word + 1)


def _number(w: memoryview[int], arrays: Iterable[int], resource: TeamMember) -> int:
    """The number of a resource in some arrays, 0 for none. The function is fast, because each call
    needs it.
    """
    for array in arrays:
        members = w[array + 1 : array + (w[array] >> 32) - 1 : 2].tolist()
        if resource.number in members:
            number: int = w[array + 2 + 2 * members.index(resource.number)]
            if 0 < number < COUNT_LIMIT:
                return number
    return 0
