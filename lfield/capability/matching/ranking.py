"""The cost of an offer, by which offers are ranked: the less, the better. It is never below 0.

Of an agent that serves the primitive itself:

    cost = fitness * F + hop * H + age * A

- F is the mean penalty of the rated attributes, weighed by `attributes` of the weights (1 by default). Rated
  for a primitive is every number with a `better` of more or less that a provider of it, or a single agent of
  the mission, states or measures. A value x of an attribute with the typical value t has the penalty
  t / (t + x) when more is better and x / (t + x) when less is, x being at least 0: from 0 over 0.5 for
  the typical value up to 1. What is not stated or not known counts as typical, so silence is no merit.
- H is the number of hops: 0 on this host, else 1.
- A is the largest age / max_age of the live attributes that are rated or named in the constraint, at most 1;
  one that is too old counts 1.

Of an offer by a one-to-one rule: the cost of the offer behind it + loss * the rule's loss. Of a composition:
the sum of its parts' costs + loss * the rule's loss + part * (parts - 1). Both grow with the costs of what
they are made of, so the cheapest parts make the cheapest whole, and a search may stop early.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from lfield.capability.matching.evaluate import Facts
from lfield.capability.model import Attribute, Registry

#: The penalty of a typical value, and of one that is not known.
TYPICAL_PENALTY = 0.5


class Rated(NamedTuple):
    """An attribute with its share in the fitness; all shares of a primitive make 1."""

    name: str
    share: float
    typical: float
    more: bool


class Ranking:
    """The costs of one registry, with its weights."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._weights = registry.weights
        self._rated: dict[str, tuple[Rated, ...]] = {}

    def rated(self, primitive: str) -> tuple[Rated, ...]:
        """What counts in the fitness for a primitive, in the order of the names."""
        if primitive not in self._rated:
            self._rated[primitive] = self._shares(sorted(set(self._stated(primitive))))
        return self._rated[primitive]

    def _stated(self, primitive: str) -> Iterator[str]:
        for provider in self._registry.providers.values():
            if primitive in provider.serves:
                yield from provider.attributes
                yield from provider.live
                yield from provider.serves[primitive].attributes
        for values in self._registry.agents.values():
            yield from values

    def _shares(self, names: Iterable[str]) -> tuple[Rated, ...]:
        known = self._registry.attributes
        counted = [known[name] for name in names if name in known and _is_rated(known[name])]
        weights = [max(self._weights.attributes.get(attribute.name, 1.0), 0.0) for attribute in counted]
        total = sum(weights)
        return tuple(
            Rated(attribute.name, weight / total, attribute.typical, attribute.better == "more")
            for attribute, weight in zip(counted, weights, strict=True)
            if weight > 0.0
        )

    def counted(self, primitive: str, named: Iterable[str]) -> dict[str, float]:
        """The attributes whose age counts, with their `max_age`; `named` are those in the constraint."""
        names = {rated.name for rated in self.rated(primitive)}.union(named)
        known = self._registry.attributes
        return {
            name: known[name].max_age
            for name in sorted(names)
            if name in known and known[name].live and known[name].max_age > 0.0
        }

    def agent(self, primitive: str, values: Facts, hops: int, staleness: float) -> float:
        """The cost of an agent that serves the primitive itself; `staleness` is A of the formula."""
        fitness = 0.0
        for name, share, typical, more in self.rated(primitive):
            value = values.get(name)
            if value is None:
                fitness += share * TYPICAL_PENALTY
                continue
            amount = max(float(value), 0.0)  # type: ignore[arg-type]  # what is rated is a number
            fitness += share * (typical if more else amount) / (typical + amount)
        weights = self._weights
        return weights.fitness * fitness + weights.hop * hops + weights.age * min(staleness, 1.0)

    def by_rule(self, behind: float, loss: float) -> float:
        """The cost of an offer that stands in by a one-to-one rule, from that of the one behind it."""
        return behind + self._weights.loss * loss

    def whole(self, parts: Iterable[float], loss: float) -> float:
        """The cost of a composition, from those of its parts."""
        costs = list(parts)
        return sum(costs) + self._weights.loss * loss + self._weights.part * (len(costs) - 1)


def _is_rated(attribute: Attribute) -> bool:
    numeric = attribute.type in ("real", "int")
    return numeric and attribute.better != "none" and attribute.typical > 0.0
