"""The cost of an offer, at least 0; offers are ranked by ascending cost.

`formula` is generated from the tables that the code uses; the capability page prints it, and `lfield query
--explain` shows its terms. Each term is a weight of the mission times an amount:

- F, the fitness, is the mean penalty of the rated attributes, weighed by `attributes` of the weights (1 by
  default). Rated for a primitive is every number with a `better` of more or less that an agent of the team
  which serves it itself states or measures, now or at another time: types without an agent do not count,
  and a lost link changes no score of the others. A value x of an attribute with the typical value t has the
  penalty t / (t + x) when more is better and x / (t + x) when less is, x being at least 0: from 0 over 0.5
  for the typical value up to 1. An unknown value counts as typical, so not reporting is no advantage.
- H is the number of hops: 0 on this host, else 1.
- N is d / (nearby + d) for an agent at d metres from the position of the query, 0.5 if its position is
  unknown; it is 0 for all if the position of the query is unknown.
- A is the largest age / max_age of the live attributes that are rated or named in the query, at most 1; an
  outdated one counts 1.

Costs are monotonic in the costs of the parts, so the cheapest parts make the cheapest composition, and a
search may stop early. Costs are rounded to nine decimals: equal ones are equal however they were added up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from lfield.capability.matching.condition_evaluator import (
    Facts,
    conjuncts,
    distance_to,
    evaluator,
    fact_names,
)
from lfield.capability.model import Attribute, Provider, Registry, Value
from lfield.capability.offer import Candidate, CostTerm, Penalty, Position

#: The penalty of a typical or unknown value.
TYPICAL_PENALTY = 0.5
#: A cost of 1 in the steps that are counted: nine decimals.
STEPS = 1e9

#: The terms of each kind of offer: the weight of the mission, and its factor.
AGENT: Mapping[str, str] = {"fitness": "F", "hop": "H", "near": "N", "age": "A"}
ONE_TO_ONE: Mapping[str, str] = {"loss": "its loss"}
ONE_TO_MANY: Mapping[str, str] = {"loss": "its loss", "part": "(parts - 1)"}
TEAM: Mapping[str, str] = {"part": "(members - 1)"}


class RatedAttribute(NamedTuple):
    """An attribute with its share in the fitness; all shares of a primitive make 1."""

    name: str
    share: float
    typical: float
    more: bool


#: From the facts of an agent, its hops, and A of the formula before it is cut off at 1: its cost, and the
#: amounts of its terms.
Costing = Callable[[Facts, int, float], tuple[float, tuple[float, ...]]]


class Ranking:
    """The costs of one registry, with its weights, for a team: `agents` returns those of a resource type."""

    def __init__(self, registry: Registry, agents: Callable[[str], Sequence[Candidate]]) -> None:
        self._registry, self._agents = registry, agents
        self._weights = registry.weights
        self._of_agent = tuple(float(getattr(registry.weights, name)) for name in AGENT)
        self._rated: dict[str, tuple[RatedAttribute, ...]] = {}

    def rated(self, primitive: str) -> tuple[RatedAttribute, ...]:
        """The rated attributes of a primitive, in the order of their names."""
        if primitive not in self._rated:
            self._rated[primitive] = self._shares(sorted(set(self._stated(primitive))))
        return self._rated[primitive]

    def _stated(self, primitive: str) -> Iterator[str]:
        for provider in self._registry.providers.values():
            served = provider.serves.get(primitive)
            for candidate in self._agents(provider.type) if served is not None else ():
                assert served is not None
                own = self._own(candidate)
                values = {**provider.attributes, **served.attributes, **own}
                live = provider.live.keys() - own.keys()
                if self._may_serve(provider, primitive, candidate, values, live):
                    yield from (*values, *live)

    def _own(self, candidate: Candidate) -> dict[str, Value]:
        """The stated attributes of a single agent, without measurements."""
        known = self._registry.attributes
        reported = {n: f.value for n, f in candidate.facts.items() if n in known and not known[n].live}
        return {**reported, **self._registry.agents.get(candidate.agent, {})}

    def _may_serve(
        self,
        provider: Provider,
        primitive: str,
        candidate: Candidate,
        stated: Mapping[str, Value],
        live: Iterable[str],
    ) -> bool:
        """Whether the condition of its type lets an agent serve, now or when it measures something else."""
        when = provider.serves[primitive].when
        if when is None:
            return True
        changing = set(live)
        host = candidate.host
        values: dict[str, Value] = {n: v for n, v in stated.items() if n not in changing}
        values |= {"agent": candidate.agent, "robot": host, "host": host}
        for conjunct in conjuncts(when):
            value = evaluator(conjunct)(values)
            if value is False or (value is None and changing.isdisjoint(fact_names(conjunct))):
                return False
        return True

    def _shares(self, stated: Iterable[str]) -> tuple[RatedAttribute, ...]:
        known = self._registry.attributes
        counted = [known[name] for name in stated if name in known and _is_rated(known[name])]
        weights = [max(self._weights.attributes.get(attribute.name, 1.0), 0.0) for attribute in counted]
        total = sum(weights)
        return tuple(
            RatedAttribute(attribute.name, weight / total, attribute.typical, attribute.better == "more")
            for attribute, weight in zip(counted, weights, strict=True)
            if weight > 0.0
        )

    def counted(self, primitive: str, named: Iterable[str]) -> dict[str, float]:
        """The attributes whose age counts, with their `max_age`; `named` are those in the question."""
        rated = {rated.name for rated in self.rated(primitive)}.union(named)
        known = self._registry.attributes
        return {
            name: known[name].max_age
            for name in sorted(rated)
            if name in known and known[name].live and known[name].max_age > 0.0
        }

    # --- an agent -------------------------------------------------------------------------------------

    def agents(self, primitive: str, position: Position | None) -> Costing:
        """The cost of an agent that provides the primitive directly, for a query at `position`."""
        rated = [(r.name, r.share, r.typical, r.more) for r in self.rated(primitive)]
        nearby = self._weights.nearby
        of_fitness, of_hop, of_near, of_age = self._of_agent

        # Everything is at hand, because a thousand agents come through here in a query.
        def costing(values: Facts, hops: int, staleness: float) -> tuple[float, tuple[float, ...]]:
            fitness, remoteness = 0.0, 0.0
            for name, share, typical, more in rated:
                fitness += share * _penalty(typical, more, values.get(name))
            if position is not None:
                distance = distance_to(values, position)
                remoteness = TYPICAL_PENALTY if distance is None else distance / (nearby + distance)
            age = staleness if staleness < 1.0 else 1.0
            cost = of_fitness * fitness + of_hop * hops + of_near * remoteness + of_age * age
            return _rounded(cost), (fitness, hops, remoteness, age)

        return costing

    def terms(self, kind: Mapping[str, str], amounts: Iterable[float]) -> tuple[CostTerm, ...]:
        """The terms of a cost, for people: those of AGENT, ONE_TO_ONE, ONE_TO_MANY or TEAM."""
        return tuple(
            CostTerm(name, amount, getattr(self._weights, name))
            for name, amount in zip(kind, amounts, strict=True)
        )

    def penalties(self, primitive: str, values: Facts) -> tuple[Penalty, ...]:
        """The penalties in the fitness of an agent, for people."""
        return tuple(
            Penalty(r.name, values.get(r.name), r.share, _penalty(r.typical, r.more, values.get(r.name)))
            for r in self.rated(primitive)
        )

    # --- rules and teams ------------------------------------------------------------------------------

    def by_rule(self, behind: float, loss: float) -> float:
        """The cost of an offer by a one-to-one rule, from that of the offer it substitutes."""
        return _rounded(behind + self._weights.loss * loss)

    def whole(self, parts: Iterable[float], loss: float = 0.0) -> float:
        """The cost of a composition, from those of its parts; that of a team has no loss."""
        total, count = 0.0, -1
        for cost in parts:
            total += cost
            count += 1
        return _rounded(total + self._weights.loss * loss + self._weights.part * count)


def _rounded(cost: float) -> float:
    # Three times as fast as round(cost, 9), and the same but for costs in the middle between two steps.
    return round(cost * STEPS) / STEPS


def _penalty(typical: float, more: bool, value: Any) -> float:
    """The penalty of a number; None: an unknown one."""
    if value is None:
        return TYPICAL_PENALTY
    amount = value if value > 0.0 else 0.0
    penalty: float = (typical if more else amount) / (typical + amount)
    return penalty


def _is_rated(attribute: Attribute) -> bool:
    numeric = attribute.type in ("real", "int")
    return numeric and attribute.better != "none" and attribute.typical > 0.0
