"""Backward data-flow analysis with bit sets: a worklist in postorder.

In this order (Kam and Ullman, 1976) a node is mostly processed after its successors: once per enclosing loop,
plus one.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heappop, heappush
from typing import NamedTuple


class Edge(NamedTuple):
    """An edge to a node, by number, that passes the bits in `through`."""

    target: int
    through: int


class Node(NamedTuple):
    """A node with its own bits, and its outgoing edges."""

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
            before[edge.target].append(place)
    sets = [0] * len(nodes)
    waiting, is_waiting = list(range(len(nodes))), [True] * len(nodes)
    while waiting:
        place = heappop(waiting)
        is_waiting[place] = False
        number = order[place]
        found = nodes[number].own
        for target, through in nodes[number].edges:
            found |= sets[target] & through
        if found != sets[number]:
            sets[number] = found
            for other in before[number]:
                if not is_waiting[other]:
                    is_waiting[other] = True
                    heappush(waiting, other)
    return sets


def _postorder(nodes: Sequence[Node]) -> list[int]:
    """All nodes, each after its successors, except in cycles."""
    order: list[int] = []
    visited = [False] * len(nodes)
    for first in range(len(nodes)):
        if visited[first]:
            continue
        visited[first] = True
        path = [(first, iter(nodes[first].edges))]
        while path:
            number, edges = path[-1]
            for target, _ in edges:
                if not visited[target]:
                    visited[target] = True
                    path.append((target, iter(nodes[target].edges)))
                    break
            else:
                order.append(number)
                path.pop()
    return order
