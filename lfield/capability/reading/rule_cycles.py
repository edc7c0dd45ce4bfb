"""Plans that would contain themselves: a need that can only be met with what it is a part of.

Rules are edges from what is served to what serves it. One-to-one rules may run in circles, since nobody is
asked twice; a circle through a need would make plans without end.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence

from lfield.capability.model import Need
from lfield.capability.reading import messages
from lfield.capability.reading.draft import Draft

#: More circles than these are not told: looking for the ways they take would be long.
MAX_CYCLES = 50

#: What serves each primitive, and by which rule.
Graph = Mapping[str, Sequence[tuple[str, str]]]


def check_cycles(draft: Draft) -> None:
    """Report every need that leads back to what its rule serves, with the way it takes."""
    graph = _graph(draft)
    component = _components({node: [to for to, _ in edges] for node, edges in graph.items()})
    circular = [
        (need, rule.name, rule.serves)
        for rule in draft.compositions.values()
        for need in rule.needs.values()
        if component[need.primitive] == component[rule.serves]
    ]
    for need, rule, serves in circular[:MAX_CYCLES]:
        path = " -> ".join([serves, f"{need.primitive} ({rule})", *_path(graph, need, serves)])
        draft.tell(messages.CYCLE, need.span, path=path)


def _graph(draft: Draft) -> Graph:
    graph: dict[str, list[tuple[str, str]]] = {name: [] for name in draft.primitives}
    for equivalence in draft.equivalences.values():
        graph[equivalence.serves].append((equivalence.by, equivalence.name))
    for composition in draft.compositions.values():
        needs = composition.needs.values()
        graph[composition.serves].extend((need.primitive, composition.name) for need in needs)
    return graph


def _components(forward: Mapping[str, Sequence[str]]) -> dict[str, int]:
    """The strongly connected components as numbers, by node (Kosaraju's two passes)."""
    backward: dict[str, list[str]] = {node: [] for node in forward}
    for node, followers in forward.items():
        for follower in followers:
            backward[follower].append(node)
    seen: set[str] = set()
    finished = [node for start in forward for node in _finished(forward, start, seen)]
    component: dict[str, int] = {}
    seen = set()
    for number, start in enumerate(reversed(finished)):
        component.update(dict.fromkeys(_finished(backward, start, seen), number))
    return component


def _finished(graph: Mapping[str, Sequence[str]], start: str, seen: set[str]) -> Iterator[str]:
    """Nodes not `seen` yet that can be reached, in the order in which a depth-first walk leaves them."""
    if start in seen:
        return
    seen.add(start)
    stack = [(start, iter(graph[start]))]
    while stack:
        node, followers = stack[-1]
        follower = next((f for f in followers if f not in seen), None)
        if follower is None:
            stack.pop()
            yield node
        else:
            seen.add(follower)
            stack.append((follower, iter(graph[follower])))


def _path(graph: Graph, need: Need, serves: str) -> list[str]:
    """A shortest way from a need back to what is served, each step with its rule."""
    came_from: dict[str, tuple[str, str]] = {}
    waiting = deque([need.primitive])
    while waiting and serves not in came_from:
        node = waiting.popleft()
        for to, rule in graph[node]:
            if to not in came_from and to != need.primitive:
                came_from[to] = (node, rule)
                waiting.append(to)
    steps: list[str] = []
    node = serves
    while node != need.primitive:
        before, rule = came_from[node]
        steps.append(f"{node} ({rule})")
        node = before
    return steps[::-1]
