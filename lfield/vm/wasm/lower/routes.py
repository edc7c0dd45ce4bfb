"""How a method is entered: at its beginning, or at one of its points.

WebAssembly has no jump into a loop. So a loop with points inside has a *test* before its header: who resumes
goes through the tests of all loops around its point, each of which sends it on by a *switch*; everybody else
passes. A loop whose only point is its own header needs none: the innermost ones stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from lfield.vm.wasm.lower.flow import domination, dominators, predecessors, reverse_postorder
from lfield.vm.wasm.lower.graph import Branch, Call, Graph, Jump, Run


@dataclass(frozen=True, slots=True)
class Test:
    """Goes to the switch when the method is being resumed, else on."""

    switch: int
    on: int


@dataclass(frozen=True, slots=True)
class Switch:
    """Goes on where the point with that number lies, or to the test of the next loop around it."""

    ways: dict[int, int]


Node = Run | Test | Switch


class Door(NamedTuple):
    """The two nodes by which who resumes comes into a loop, or into the method."""

    test: int
    switch: int


def _door(number: int) -> Door:
    """Below 0, where no instruction is."""
    return Door(-1 - 2 * number, -2 - 2 * number)


#: The method's own.
ROOT = _door(0)


class Irreducible(Exception):
    """Control enters a loop at several places: no compiler of ours makes that, and no engine must run it."""


class Routes:
    """The graph with its tests and switches: nodes by number, those of runs their first instruction's.

    `numbers` has the number of each point by its instruction, from 1.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        order = reverse_postorder(graph.entry, graph.leads_to)
        before = predecessors(order, graph.leads_to)
        self._dominates = domination(order, dominators(order, before))
        # In the order of the code: those of a loop have numbers one after another, its switch has no gaps.
        points = [pc for pc in sorted(order) if pc in graph.points]
        self.numbers = {pc: i for i, pc in enumerate(points, 1)}
        loops = self._loops(order, before)
        around: dict[int, list[int]] = {pc: [] for pc in points}
        for header, body in loops.items():
            for pc in body & around.keys():
                around[pc].append(header)
        inside = {header for pc, headers in around.items() for header in headers if header != pc}
        #: By header, for loops with points inside.
        self._doors = {
            header: _door(number) for number, header in enumerate((h for h in loops if h in inside), 1)
        }
        self.nodes: dict[int, Node] = {pc: graph.runs[pc] for pc in order} | self._entries(around)

    def _loops(self, order: list[int], before: dict[int, list[int]]) -> dict[int, set[int]]:
        """The nodes of each loop by its header, outer loops first; raises Irreducible."""
        place = {pc: i for i, pc in enumerate(order)}
        loops: dict[int, set[int]] = {}
        for header in order:
            back = [pc for pc in before[header] if place[pc] >= place[header]]
            if not back:
                continue
            if not all(self._dominates(header, pc) for pc in back):
                raise Irreducible
            body = loops.setdefault(header, {header})
            pending = back
            while pending:
                pc = pending.pop()
                if pc not in body:
                    body.add(pc)
                    pending += before[pc]
        return loops

    def _entries(self, around: dict[int, list[int]]) -> dict[int, Node]:
        """The tests and switches: who resumes goes by the root's, then by those of the loops around."""
        ways: dict[Door, dict[int, int]] = {door: {} for door in (ROOT, *self._doors.values())}
        for pc, headers in around.items():
            at = ROOT
            for door in (self._doors[header] for header in headers if header in self._doors):
                ways[at][self.numbers[pc]] = door.test
                at = door
            ways[at][self.numbers[pc]] = pc
        behind = {ROOT: self.first(self._graph.entry)} | {door: pc for pc, door in self._doors.items()}
        tests = {door.test: Test(door.switch, on) for door, on in behind.items()}
        return {**tests, **{door.switch: Switch(found) for door, found in ways.items()}}

    def first(self, pc: int) -> int:
        """The node that a jump to a run leads to: the test of its loop, if it begins one that has a test."""
        return self._doors[pc].test if pc in self._doors else pc

    def leads_to(self, node: int) -> list[int]:
        """Where control goes from a node within the method."""
        match self.nodes[node]:
            case Test(switch, on):
                return [on, switch]
            case Switch(ways):
                return list(dict.fromkeys(ways.values()))
            case Run(end=Jump(to) | Call(_, to)):
                return [self.first(to)]
            case Run(end=Branch(_, yes, no)):
                return list(dict.fromkeys((self.first(yes), self.first(no))))
            case _:
                return []
