"""Backward data flow over a graph, sets as bits of an int: a worklist in postorder.

What a node gives is what it has itself, and what comes back along the edges that leave it. In this order (Kam
and Ullman, 1976) a node is mostly taken up when those that it leads to are done, whatever the order of the
code is: each only as often as loops are nested around it, and once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappop, heappush
from typing import NamedTuple


class Edge(NamedTuple):
    """Leads to a node, by its number, and lets back what is in `through`."""

    to: int
    through: int


class Node(NamedTuple):
    """What it has itself, and the edges that leave it."""

    own: int
    edges: Sequence[Edge]


def solve(nodes: Sequence[Node]) -> list[int]:
    """The least sets with `set = own | (set of to & through)` for every node and each of its edges."""
    order = _postorder(nodes)
    rank = [0] * len(nodes)
    before: list[list[int]] = [[] for _ in nodes]
    for place, number in enumerate(order):
        rank[number] = place
        for edge in nodes[number].edges:
            before[edge.to].append(place)
    sets = [0] * len(nodes)
    waiting, is_waiting = list(range(len(nodes))), [True] * len(nodes)
    while waiting:
        place = heappop(waiting)
        is_waiting[place] = False
        number = order[place]
        found = nodes[number].own
        for to, through in nodes[number].edges:
            found |= sets[to] & through
        if found != sets[number]:
            sets[number] = found
            for other in before[number]:
                if not is_waiting[other]:
                    is_waiting[other] = True
                    heappush(waiting, other)
    return sets


def _postorder(nodes: Sequence[Node]) -> list[int]:
    """All nodes, each behind those that it leads to, but for circles."""
    order: list[int] = []
    seen = [False] * len(nodes)
    for first in range(len(nodes)):
        if seen[first]:
            continue
        seen[first] = True
        path = [(first, iter(nodes[first].edges))]
        while path:
            number, edges = path[-1]
            for to, _ in edges:
                if not seen[to]:
                    seen[to] = True
                    path.append((to, iter(nodes[to].edges)))
                    break
            else:
                order.append(number)
                path.pop()
    return order
