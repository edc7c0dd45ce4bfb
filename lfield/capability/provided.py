"""Agents of a resource type as plans for a primitive that the type serves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lfield.capability import ways
from lfield.capability.evaluate import conjuncts, evaluator
from lfield.capability.model import Attribute, Provider, Value
from lfield.capability.offer import Candidate, Fact, Offer
from lfield.capability.plan import Plan
from lfield.capability.ranking import Ranking
from lfield.capability.reasons import reasons


@dataclass(frozen=True, slots=True)
class _Kept:
    """What was made of a candidate, good as long as it is the same and the same live facts are named."""

    candidate: Candidate
    named: frozenset[str]
    plan: Plan


class Provided:
    """One primitive as one resource type serves it."""

    def __init__(
        self, primitive: str, provider: Provider, attributes: Mapping[str, Attribute], ranking: Ranking
    ) -> None:
        served = provider.serves[primitive]
        self.primitive, self.type = primitive, provider.type
        self._when = served.when
        self._judges = [evaluator(c) for c in conjuncts(served.when)] if served.when else []
        self._attributes, self._ranking = attributes, ranking
        self._way = ways.direct(provider.type)
        self._values: dict[str, Value] = {**provider.attributes, **served.attributes}
        self._facts = {name: Fact(value) for name, value in self._values.items()}
        self._kept: dict[str, _Kept] = {}

    def plans(self, candidates: Iterable[Candidate], named: frozenset[str]) -> list[Plan]:
        """Of the candidates that can do it now; `named` are the attributes in the constraint."""
        found = []
        for candidate in candidates:
            if candidate.refusal:
                continue
            plan = self.plan(candidate, named)
            if plan.fulfils(self._judges):
                found.append(plan)
        return found

    def refusal(self, candidate: Candidate, named: frozenset[str]) -> tuple[str, ...]:
        """Why a candidate cannot do it whatever is wished; () when it can."""
        if candidate.refusal:
            return (candidate.refusal,)
        if self._when is None:
            return ()
        plan = self.plan(candidate, named)
        return reasons(self._when, plan.values, plan.why)

    def plan(self, candidate: Candidate, named: frozenset[str]) -> Plan:
        """What a candidate would be, made anew only when something about it changed."""
        kept = self._kept.get(candidate.agent)
        if kept is not None and kept.candidate is candidate and kept.named == named:
            return kept.plan
        plan = self._made(candidate, named)
        self._kept[candidate.agent] = _Kept(candidate, named, plan)
        return plan

    def _made(self, candidate: Candidate, named: frozenset[str]) -> Plan:
        facts = {**self._facts, **candidate.facts}
        unknown = {**candidate.unknown, **self._useless(candidate)}
        for name in unknown:
            facts.pop(name, None)
        host = candidate.host
        values = {name: fact.value for name, fact in facts.items()}
        values |= {"agent": candidate.agent, "robot": host, "host": host}
        staleness = self._ranking.staleness(self.primitive, candidate.facts, named)
        cost = self._ranking.agent(self.primitive, values, candidate.hops, staleness)
        offer = Offer(self.primitive, "direct", self._way, candidate.agent, host, cost, facts)
        return Plan(offer, cost, values, unknown)

    def _useless(self, candidate: Candidate) -> dict[str, str]:
        """The live facts that say nothing, and why."""
        found = {}
        for name, fact in candidate.facts.items():
            limit = self._attributes[name].max_age if fact.age and name in self._attributes else math.inf
            if fact.age > limit:
                found[name] = f"{name} is {_seconds(fact.age, limit)} old, at most {limit:g} s"
            elif isinstance(fact.value, float) and not math.isfinite(fact.value):
                found[name] = f"{name} is not a number"
        return found


def _seconds(age: float, limit: float) -> str:
    """An age in few digits, yet not so few that it looks within its limit."""
    rounded = round(age)
    return f"{rounded} s" if rounded > limit else f"{age:g} s"
