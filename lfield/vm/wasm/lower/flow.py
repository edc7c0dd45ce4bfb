"""Graphs of control: reverse postorder and dominators, in nearly as many steps as there are edges."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import reduce

Successors = Callable[[int], Iterable[int]]


def reverse_postorder(root: int, successors: Successors) -> list[int]:
    """All nodes that can be reached, each before those it leads to, but for the edges that lead back."""
    seen = {root}
    done: list[int] = []
    stack = [(root, iter(list(successors(root))))]
    while stack:
        node, rest = stack[-1]
        following = next((n for n in rest if n not in seen), None)
        if following is None:
            stack.pop()
            done.append(node)
        else:
            seen.add(following)
            stack.append((following, iter(list(successors(following)))))
    return done[::-1]


def predecessors(order: list[int], successors: Successors) -> dict[int, list[int]]:
    """Who leads to each node of the order."""
    found: dict[int, list[int]] = {node: [] for node in order}
    for node in order:
        for following in dict.fromkeys(successors(node)):
            found[following].append(node)
    return found


def dominators(order: list[int], before: dict[int, list[int]]) -> dict[int, int]:
    """The immediate dominator of each node; of the root it is the root.

    Edges that lead back are left out: where each loop has one entry, they lead to a dominator and change
    nothing. Where one has two, its edge leads to no dominator here either.
    """
    tree = _Tree(order[0])
    for node in order[1:]:
        tree.add(node, reduce(tree.common, (n for n in before[node] if n in tree.above)))
    return tree.above


class _Tree:
    """A tree that grows at its leaves, with a jump far up from each node (Myers, 1983)."""

    def __init__(self, root: int) -> None:
        self.above = {root: root}
        self._jump, self._depth = {root: root}, {root: 0}

    def add(self, node: int, above: int) -> None:
        """A new leaf."""
        depth, jump = self._depth, self._jump
        far = jump[above]
        even = depth[above] - depth[far] == depth[far] - depth[jump[far]]
        self.above[node], depth[node] = above, depth[above] + 1
        jump[node] = jump[far] if even else above

    def common(self, a: int, b: int) -> int:
        """The lowest node above both, or one of them: found in few steps, however high the tree is."""
        a, b = self._up(a, self._depth[b]), self._up(b, self._depth[a])
        while a != b:
            # From the same depth jumps lead to the same depth.
            way = self.above if self._jump[a] == self._jump[b] else self._jump
            a, b = way[a], way[b]
        return a

    def _up(self, node: int, depth: int) -> int:
        while self._depth[node] > depth:
            far = self._jump[node]
            node = far if self._depth[far] >= depth else self.above[node]
        return node


def domination(order: list[int], above: dict[int, int]) -> Callable[[int, int], bool]:
    """Whether every way to a node leads over another one (or it is that): asked with the upper one first.

    Each node has the numbers of all nodes that it dominates behind its own, so nothing is gone through.
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
