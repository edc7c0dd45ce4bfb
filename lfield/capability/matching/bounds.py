"""The least that a plan for a primitive can cost, whatever the conditions of rules leave of it.

This is Knuth's generalisation of Dijkstra's algorithm to AND/OR graphs (Information Processing Letters 6,
1977): primitives are settled in the order of their least costs; a rule counts when all it needs are settled.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping

from lfield.capability.matching.rules import Rules


def least_costs(rules: Rules, wanted: str, agents: Callable[[str], float | None]) -> Mapping[str, float]:
    """The least cost of every primitive that may be part of a plan for the `wanted` one.

    `agents` gives that of the agents which serve a primitive themselves. Who cannot be served is left out.
    """
    settled: dict[str, float] = {}
    own = ((name, agents(name)) for name in rules.reached(wanted))
    waiting = [(cost, name) for name, cost in own if cost is not None]
    heapq.heapify(waiting)
    while waiting:
        cost, primitive = heapq.heappop(waiting)
        if primitive not in settled:
            settled[primitive] = cost
            for served in _following(rules, primitive, settled):
                heapq.heappush(waiting, served)
    return settled


def _following(rules: Rules, primitive: str, settled: Mapping[str, float]) -> Iterator[tuple[float, str]]:
    """What can be served now that a primitive is settled, at which cost."""
    for rule in rules.equivalences_by(primitive):
        yield rules.ranking.by_rule(settled[primitive], rule.loss), rule.serves
    for assembly in rules.compositions_with(primitive):
        least = assembly.least(settled)
        if least is not None:
            yield least, assembly.rule.serves
