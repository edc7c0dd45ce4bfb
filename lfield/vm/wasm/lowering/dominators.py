"""Reverse postorder and dominators of control-flow graphs, in almost linear time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import reduce

Successors = Callable[[int], Iterable[int]]


def reverse_postorder(root: int, successors: Successors) -> list[int]:
    """All reachable nodes, each before its successors, except for back edges."""
    visited = {root}
    finished: list[int] = []
    stack = [(root, iter(list(successors(root))))]
    while stack:
        node, rest = stack[-1]
        following = next((n for n in rest if n not in visited), None)
        if following is None:
            stack.pop()
            finished.append(node)
        else:
            visited.add(following)
            stack.append((following, iter(list(successors(following)))))
    return finished[::-1]


def predecessors(order: list[int], successors: Successors) -> dict[int, list[int]]:
    """The predecessors of each node of the order."""
    found: dict[int, list[int]] = {node: [] for node in order}
    for node in order:
        for following in dict.fromkeys(successors(node)):
            found[following].append(node)
    return found


def immediate_dominators(order: list[int], before: dict[int, list[int]]) -> dict[int, int]:
    """The immediate dominator of each node; of the root itself.

    Back edges are omitted: in a loop with one entry they lead to a dominator and have no effect. In a loop
    with two entries the edge does not lead to a dominator with or without them.
    """
    tree = _Tree(order[0])
    for node in order[1:]:
        tree.add(node, reduce(tree.common, (n for n in before[node] if n in tree.above)))
    return tree.above


class _Tree:
    """A tree that grows at its leaves, with a long jump pointer from each node (Myers, 1983)."""

    def __init__(self, root: int) -> None:
        self.above = {root: root}
        self._jump, self._depth = {root: root}, {root: 0}

    def add(self, node: int, above: int) -> None:
        """Add a leaf."""
        depth, jump = self._depth, self._jump
        jump_target = jump[above]
        even = depth[above] - depth[jump_target] == depth[jump_target] - depth[jump[jump_target]]
        self.above[node], depth[node] = above, depth[above] + 1
        jump[node] = jump[jump_target] if even else above

    def common(self, a: int, b: int) -> int:
        """The lowest common ancestor of both, in logarithmic time."""
        a, b = self._up(a, self._depth[b]), self._up(b, self._depth[a])
        while a != b:
            # Nodes of equal depth have jumps to equal depth.
            pointers = self.above if self._jump[a] == self._jump[b] else self._jump
            a, b = pointers[a], pointers[b]
        return a

    def _up(self, node: int, depth: int) -> int:
        while self._depth[node] > depth:
            jump_target = self._jump[node]
            node = jump_target if self._depth[jump_target] >= depth else self.above[node]
        return node


def domination(order: list[int], above: dict[int, int]) -> Callable[[int, int], bool]:
    """Whether a node is dominated by another node, or is that node; called with the upper node first.

    Each node's number is followed by the numbers of all nodes that it dominates.
    """
    size = dict.fromkeys(order, 1)
    for node in reversed(order[1:]):
        size[above[node]] += size[node]
    first, free = {order[0]: 0}, {order[0]: 1}
    for node in order[1:]:
        first[node] = free[above[node]]
        free[above[node]] += size[node]
        free[node] = first[node] + 1
    return lambda upper, node: first[upper] <= first[node] < first[upper] + size[upper]
