"""Agents of a resource type as plans for a primitive that the type serves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial

from lfield.capability import ways
from lfield.capability.matching.evaluate import Facts, conjuncts, evaluator
from lfield.capability.matching.plan import Plan, fulfilling
from lfield.capability.matching.ranking import AGENT, Ranking
from lfield.capability.matching.reasons import reasons
from lfield.capability.model import Attribute, Provider, Value
from lfield.capability.offer import Candidate, Fact, Offer, Place


@dataclass(frozen=True, slots=True)
class Asked:
    """What of a question counts for the cost of an agent: the attributes it names, and where it is asked."""

    named: frozenset[str] = frozenset()
    here: Place | None = None


class Provided:
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
        self._way = ways.direct(provider.type)
        self._own = served.attributes.keys()
        self._values: dict[str, Value] = {**provider.attributes, **served.attributes}
        nominal = served.nominal | (provider.nominal - served.attributes.keys())
        self._facts = {
            name: Fact(value, of="nominal" if name in nominal else "stated")
            for name, value in self._values.items()
        }
        self._kept: dict[str, tuple[Candidate, Plan]] = {}
        self._asked: Asked | None = None
        self._counted: Mapping[str, float] = {}
        self._here: Place | None = None

    def plans(self, candidates: Iterable[Candidate], asked: Asked) -> list[Plan]:
        """Of the candidates that can do it now."""
        found = [self.plan(candidate, asked) for candidate in candidates if not candidate.refusal]
        return list(fulfilling(found, self._judges)) if self._judges else found

    def refusal(self, candidate: Candidate, asked: Asked) -> tuple[str, ...]:
        """Why a candidate cannot do it whatever is wished; () when it can."""
        if candidate.refusal:
            return (candidate.refusal,)
        if self._when is None:
            return ()
        plan = self.plan(candidate, asked)
        return reasons(self._when, plan.values, plan.why, plan.source)

    def plan(self, candidate: Candidate, asked: Asked) -> Plan:
        """What a candidate would be, made anew only when something about it changed."""
        if asked is not self._asked:
            self._count(asked)
        kept = self._kept.get(candidate.agent)
        if kept is not None and (kept[0] is candidate or kept[0] == candidate):
            return kept[1]
        plan = self._made(candidate)
        self._kept[candidate.agent] = candidate, plan
        return plan

    def _count(self, asked: Asked) -> None:
        """From now on the ages of what is named count too, and distances from where is asked."""
        counted = self._ranking.counted(self.primitive, asked.named)
        if counted != self._counted or asked.here != self._here:
            self._kept.clear()
        self._asked, self._counted, self._here = asked, counted, asked.here

    def _made(self, candidate: Candidate) -> Plan:
        host, known, staleness = candidate.host, self._counting(candidate.facts), 0.0
        facts = {**self._facts, **known}
        values = {**self._values, "agent": candidate.agent, "robot": host, "host": host}
        unknown = dict(candidate.unknown)
        for name, fact in known.items():
            values[name] = fact.value
            if name in self._live:
                unknown |= self._useless(name, fact)
            if name in self._counted:
                staleness = max(staleness, fact.age / self._counted[name])
        for name in unknown:
            facts.pop(name, None)
            values.pop(name, None)
        cost, amounts = self._ranking.agent(self.primitive, values, candidate.hops, staleness, self._here)
        make = partial(self._offer, candidate, facts, values, cost, amounts)
        return Plan(make, (cost, 0, (), (candidate.number,)), values, unknown)

    def _counting(self, facts: Mapping[str, Fact]) -> Mapping[str, Fact]:
        """What is said of a candidate, without what it tells of itself where this primitive says otherwise.

        A copter goes 10 m/s, and what hangs on its winch does not.
        """
        if not self._own:
            return facts
        return {name: f for name, f in facts.items() if f.of != "told" or name not in self._own}

    def _offer(
        self,
        candidate: Candidate,
        facts: Mapping[str, Fact],
        values: Facts,
        cost: float,
        amounts: tuple[float, ...],
    ) -> Offer:
        return Offer(
            self.primitive,
            "direct",
            self._way,
            candidate.agent,
            candidate.host,
            cost,
            facts,
            terms=self._ranking.terms(AGENT, amounts),
            penalties=self._ranking.penalties(self.primitive, values),
        )

    def _useless(self, name: str, fact: Fact) -> dict[str, str]:
        """Why a live fact says nothing; {} when it does."""
        limit = self._live[name]
        if fact.age > limit:
            return {name: f"{name} is {_seconds(fact.age, limit)} old, at most {limit:g} s"}
        if isinstance(fact.value, float) and not math.isfinite(fact.value):
            return {name: f"{name} is not a number"}
        return {}


def _seconds(age: float, limit: float) -> str:
    """An age in few digits, yet not so few that it looks within its limit."""
    rounded = round(age)
    return f"{rounded} s" if rounded > limit else f"{age:g} s"
