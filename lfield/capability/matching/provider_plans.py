"""Agents of a resource type as plans for a primitive that the type serves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from msgspec import Struct

from lfield.capability import realisations
from lfield.capability.matching.condition_evaluator import conjuncts, evaluator
from lfield.capability.matching.failure_reasons import failure_reasons
from lfield.capability.matching.plan import Plan, satisfying
from lfield.capability.matching.ranking import AGENT, Costing, Ranking
from lfield.capability.model import Attribute, Provider, Value
from lfield.capability.offer import Candidate, Fact, Offer, Position


class CostContext(Struct, frozen=True):
    """The parts of a query that affect the cost of an agent: its attributes and its position."""

    named: frozenset[str] = frozenset()
    location: Position | None = None


class ProviderPlans:
    """One primitive as one resource type serves it."""

    def __init__(
        self, primitive: str, provider: Provider, attributes: Mapping[str, Attribute], ranking: Ranking
    ) -> None:
        served = provider.serves[primitive]
        self.primitive, self.type = primitive, provider.type
        self._when = served.when
        self._judges = [evaluator(c) for c in conjuncts(served.when)] if served.when else []
        self._ranking = ranking
        self._live = {name: attribute.max_age for name, attribute in attributes.items() if attribute.live}
        self._field = realisations.direct(provider.type)
        self._own = served.attributes.keys()
        self._values: dict[str, Value] = {**provider.attributes, **served.attributes}
        nominal = served.nominal | (provider.nominal - served.attributes.keys())
        self._facts = {
            name: Fact(value, of="nominal" if name in nominal else "stated")
            for name, value in self._values.items()
        }
        self._bases: dict[str, tuple[Mapping[str, Fact], dict[str, Value]]] = {}
        self._cached: dict[str, Plan] = {}
        self._make = self._offer
        self._context: CostContext | None = None
        self._counted: Mapping[str, float] = {}
        #: The costs of agents for the last query.
        self._costing: Costing

    def plans(self, candidates: Iterable[Candidate], context: CostContext) -> list[Plan]:
        """The plans of the candidates that can serve the primitive now."""
        able = (c for c in candidates if not c.refusal and self.primitive not in c.denials)
        found = [self.plan(candidate, context) for candidate in able]
        return list(satisfying(found, self._judges)) if self._judges else found

    def refusal(self, candidate: Candidate, context: CostContext) -> tuple[str, ...]:
        """The reasons why a candidate cannot serve the primitive under any condition; () when it can."""
        if candidate.refusal:
            return (candidate.refusal,)
        if reason := candidate.denials.get(self.primitive):
            return (reason,)
        if self._when is None:
            return ()
        plan = self.plan(candidate, context)
        return failure_reasons(self._when, plan.values, plan.unknown_reason, plan.source)

    def plan(self, candidate: Candidate, context: CostContext) -> Plan:
        """The plan of a candidate, made anew only when the candidate or the context has changed."""
        if context is not self._context:
            self._set_context(context)
        cached = self._cached.get(candidate.agent)
        if cached is None or cached.inputs[0] is not candidate:
            cached = self._cached[candidate.agent] = self._make_plan(candidate)
        return cached

    def _set_context(self, context: CostContext) -> None:
        """Sets the query: its attributes, whose ages count, and its position, for distances."""
        counted = self._ranking.counted(self.primitive, context.named)
        if self._context is None or (counted, context.location) != (self._counted, self._context.location):
            self._cached.clear()
            self._costing = self._ranking.agents(self.primitive, context.location)
        self._context, self._counted = context, counted

    def _make_plan(self, candidate: Candidate) -> Plan:
        # Written out, because a thousand agents come through here in a query.
        facts, live, unknown = self._counting(candidate.facts), self._live, candidate.unknown
        values = self._stated(candidate).copy()
        for name, fact in facts.items():
            value = values[name] = fact.value
            too_old = name in live and fact.age > live[name]
            if too_old or (type(value) is float and not math.isfinite(value)):
                unknown = {**unknown, name: self._useless_reason(name, fact)}
        for name in unknown:
            values.pop(name, None)
        staleness = 0.0
        for name, limit in self._counted.items():
            if name in facts and facts[name].age > staleness * limit:
                staleness = facts[name].age / limit
        cost, amounts = self._costing(values, candidate.hops, staleness)
        rank = cost, 0, (), (candidate.number,)
        return Plan(self._make, (candidate, amounts), rank, values, unknown)

    def _stated(self, candidate: Candidate) -> dict[str, Value]:
        """The static attributes of an agent, computed once."""
        cached = self._bases.get(candidate.agent)
        if cached is None or cached[0] is not candidate.stated:
            own, host = candidate.stated, candidate.host
            values = {**self._values, "agent": candidate.agent, "robot": host, "host": host}
            cached = own, values | {name: fact.value for name, fact in own.items()}
            self._bases[candidate.agent] = cached
        return cached[1]

    def _counting(self, facts: Mapping[str, Fact]) -> Mapping[str, Fact]:
        """The attributes of a candidate, without reported ones that this primitive overrides.

        For example, a copter flies 10 m/s, but not with a load on its winch.
        """
        if not self._own:
            return facts
        return {name: f for name, f in facts.items() if f.of != "told" or name not in self._own}

    def _offer(self, plan: Plan) -> Offer:
        candidate, amounts = plan.inputs
        facts = {**self._facts, **self._counting(candidate.facts), **candidate.stated}
        facts = {name: fact for name, fact in facts.items() if name not in plan.unknown}
        return Offer(
            self.primitive,
            "direct",
            self._field,
            candidate.agent,
            candidate.host,
            plan.cost,
            facts,
            terms=self._ranking.terms(AGENT, amounts),
            penalties=self._ranking.penalties(self.primitive, plan.values),
        )

    def _useless_reason(self, name: str, fact: Fact) -> str:
        """The reason why a fact has no usable value."""
        limit = self._live.get(name, math.inf)
        if fact.age > limit:
            return f"{name} is {_seconds(fact.age, limit)} old, at most {limit:g} s"
        return f"{name} is not a number"


def _seconds(age: float, limit: float) -> str:
    """An age in few digits, but enough to show that it exceeds its limit."""
    rounded = round(age)
    return f"{rounded} s" if rounded > limit else f"{age:g} s"
