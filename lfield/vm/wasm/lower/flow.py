"""Graphs of control: reverse postorder and dominators (Cooper, Harvey, Kennedy, 2001)."""

from __future__ import annotations

from collections.abc import Callable, Iterable

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
    """The immediate dominator of each node; of the root it is the root."""
    number = {node: i for i, node in enumerate(order)}
    root = order[0]
    above = {root: root}
    changed = True
    while changed:
        changed = False
        for node in order[1:]:
            known = [n for n in before[node] if n in above]
            nearest = known[0]
            for other in known[1:]:
                nearest = _common(above, number, nearest, other)
            if above.get(node) != nearest:
                above[node] = nearest
                changed = True
    return above


def _common(above: dict[int, int], number: dict[int, int], a: int, b: int) -> int:
    while a != b:
        while number[a] > number[b]:
            a = above[a]
        while number[b] > number[a]:
            b = above[b]
    return a


def dominates(above: dict[int, int], upper: int, node: int) -> bool:
    """Whether every way to a node leads over another one (or it is that)."""
    while node != upper and above[node] != node:
        node = above[node]
    return node == upper
