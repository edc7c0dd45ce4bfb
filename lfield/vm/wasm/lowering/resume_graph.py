"""Resumption of methods at their start or a point, without jumps into loops.

WebAssembly cannot jump into a loop. A loop with points inside therefore has a *test* before its header: a
resumed method passes the tests of all loops around its point, each of which dispatches it by a *switch*;
normal control skips the tests. A loop whose only point is its header, such as most innermost loops, needs no
test.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec import Struct

from lfield.vm.wasm.lowering.control_flow_graph import (
    BasicBlock,
    BranchExit,
    CallExit,
    ControlFlowGraph,
    JumpExit,
)
from lfield.vm.wasm.lowering.dominators import (
    domination,
    immediate_dominators,
    predecessors,
    reverse_postorder,
)


class ResumeTest(Struct, frozen=True):
    """Goes to the switch if the method is being resumed, otherwise to `entry`."""

    switch: int
    entry: int


class ResumeSwitch(Struct, frozen=True):
    """Continues at the point with that number, or at the test of the next loop around it."""

    targets: dict[int, int]


Node = BasicBlock | ResumeTest | ResumeSwitch


class ResumeEntry(NamedTuple):
    """The two nodes by which a resumed method enters a loop, or the method."""

    test: int
    switch: int


def _resume_entry(number: int) -> ResumeEntry:
    """The entry with numbers below 0, which no instruction has."""
    return ResumeEntry(-1 - 2 * number, -2 - 2 * number)


#: The entry of the method.
ROOT = _resume_entry(0)


class Irreducible(Exception):
    """A loop with several entries, which the compiler never generates; it is not lowered."""


class ResumeGraph:
    """The graph with its tests and switches: nodes by number, blocks by their first instruction.

    `numbers` has the number of each point by its instruction, from 1.
    """

    def __init__(self, graph: ControlFlowGraph) -> None:
        self._graph = graph
        order = reverse_postorder(graph.entry, graph.leads_to)
        before = predecessors(order, graph.leads_to)
        self._dominates = domination(order, immediate_dominators(order, before))
        # In code order, the points of a loop have consecutive numbers, so its switch has no gaps.
        points = [pc for pc in sorted(order) if pc in graph.points]
        self.numbers = {pc: i for i, pc in enumerate(points, 1)}
        loops = self._loops(order, before)
        around: dict[int, list[int]] = {pc: [] for pc in points}
        for header, body in loops.items():
            for pc in body & around.keys():
                around[pc].append(header)
        resumable_headers = {header for pc, headers in around.items() for header in headers if header != pc}
        #: The entries by header, for loops with points inside.
        self._resume_entries = {
            header: _resume_entry(number)
            for number, header in enumerate((h for h in loops if h in resumable_headers), 1)
        }
        self.nodes: dict[int, Node] = {pc: graph.blocks[pc] for pc in order} | self._entries(around)

    def _loops(self, order: list[int], before: dict[int, list[int]]) -> dict[int, set[int]]:
        """The nodes of each loop by its header, outer loops first. Raises Irreducible."""
        place = {pc: i for i, pc in enumerate(order)}
        loops: dict[int, set[int]] = {}
        for header in order:
            back_edges = [pc for pc in before[header] if place[pc] >= place[header]]
            if not back_edges:
                continue
            if not all(self._dominates(header, pc) for pc in back_edges):
                raise Irreducible
            body = loops.setdefault(header, {header})
            pending = back_edges
            while pending:
                pc = pending.pop()
                if pc not in body:
                    body.add(pc)
                    pending += before[pc]
        return loops

    def _entries(self, around: dict[int, list[int]]) -> dict[int, Node]:
        """The tests and switches: resumption starts at the entry of the root, then passes the entries of the
        loops.
        """
        targets: dict[ResumeEntry, dict[int, int]] = {
            entry: {} for entry in (ROOT, *self._resume_entries.values())
        }
        for pc, headers in around.items():
            at = ROOT
            for entry in (
                self._resume_entries[header] for header in headers if header in self._resume_entries
            ):
                targets[at][self.numbers[pc]] = entry.test
                at = entry
            targets[at][self.numbers[pc]] = pc
        behind = {ROOT: self.first(self._graph.entry)} | {
            entry: pc for pc, entry in self._resume_entries.items()
        }
        tests = {entry.test: ResumeTest(entry.switch, onward) for entry, onward in behind.items()}
        return {**tests, **{entry.switch: ResumeSwitch(found) for entry, found in targets.items()}}

    def first(self, pc: int) -> int:
        """The target of a jump to a block: the test of its loop if the block is a header with a test."""
        return self._resume_entries[pc].test if pc in self._resume_entries else pc

    def leads_to(self, node: int) -> list[int]:
        """Successors of a node within the method."""
        match self.nodes[node]:
            case ResumeTest(switch, entry):
                return [entry, switch]
            case ResumeSwitch(targets):
                return list(dict.fromkeys(targets.values()))
            case BasicBlock(end=JumpExit(target) | CallExit(_, target)):
                return [self.first(target)]
            case BasicBlock(end=BranchExit(_, yes, no)):
                return list(dict.fromkeys((self.first(yes), self.first(no))))
            case _:
                return []
