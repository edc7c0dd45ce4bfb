"""How a method is entered: at its beginning, or at one of its points.

WebAssembly has no jump into a loop. So a loop with points inside has a *test* before its header: who resumes
goes through the tests of all loops around its point, each of which sends it on by a *switch*; everybody else
passes. A loop whose only point is its own header needs none: the innermost ones stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

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
        #: By header: the node of its test, for loops that have one.
        self._tests: dict[int, int] = {}
        self.nodes: dict[int, Node] = {pc: graph.runs[pc] for pc in order}
        self._route(points, loops)

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

    def _route(self, points: list[int], loops: dict[int, set[int]]) -> None:
        around: dict[int, list[int]] = {pc: [] for pc in points}
        for header, body in loops.items():
            for pc in body & around.keys():
                around[pc].append(header)
        tested = {header for pc, headers in around.items() for header in headers if header != pc}
        # The root's are the nodes -1 and -2; those of a loop follow.
        self._tests = {header: -3 - 2 * i for i, header in enumerate(h for h in loops if h in tested)}
        ways: dict[int, dict[int, int]] = {-1: {}, **{test: {} for test in self._tests.values()}}
        for pc in points:
            at = -1
            for header in around[pc]:
                if (test := self._tests.get(header)) is not None:
                    ways[at][self.numbers[pc]] = test
                    at = test
            ways[at][self.numbers[pc]] = pc
        self.nodes[-1] = Test(-2, self.first(self._graph.entry))
        for header, test in self._tests.items():
            self.nodes[test] = Test(test - 1, header)
        for test, found in ways.items():
            self.nodes[test - 1] = Switch(found)

    def first(self, pc: int) -> int:
        """The node that a jump to a run leads to: the test of its loop, if it begins one that has a test."""
        return self._tests.get(pc, pc)

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
