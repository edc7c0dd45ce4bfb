"""Parts put together by the rule of a composition."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations
from typing import get_args

from lfield.capability import realisations
from lfield.capability.matching.best_first_join import BestFirstJoin, PlanStream, SearchBudget
from lfield.capability.matching.condition_checker import POSITION
from lfield.capability.matching.condition_evaluator import evaluator, fact_names
from lfield.capability.matching.failure_reasons import failure_reasons
from lfield.capability.matching.plan import Plan
from lfield.capability.matching.pushdown import PushedDown, push_down
from lfield.capability.matching.ranking import ONE_TO_MANY, Ranking
from lfield.capability.model import Composition, Expression, Value
from lfield.capability.offer import Fact, Offer, Provenance
from lfield.text.suggestions import listed

#: The number of queries whose conditions on the parts are cached.
CACHE_SIZE = 64
#: The less reliable first.
_SURER: Sequence[Provenance] = get_args(Provenance)


class Assembly:
    """A composition, ready to judge and to make combinations of parts in the order of its needs."""

    def __init__(self, rule: Composition, ranking: Ranking) -> None:
        self.rule = rule
        self._ranking = ranking
        self._needs = list(rule.needs)
        self._field = realisations.composed(rule.name)
        self._fields = [realisations.part(rule.name, need) for need in rule.needs]
        self._attributes = [(name, evaluator(e), e) for name, e in sorted(rule.attributes.items())]
        self._distinct = frozenset(self._needs.index(need) for need in rule.distinct)
        expressions = [*rule.where, *rule.attributes.values()]
        self._inputs = [
            (name, *self._place(name))
            for name in dict.fromkeys(name for e in expressions for name in fact_names(e))
            if "." in name
        ]
        self.pushed_down = lru_cache(CACHE_SIZE)(self._push_down)

    def _push_down(self, conditions: tuple[Expression, ...]) -> list[PushedDown]:
        """The conditions of the rule and the query, moved to the parts."""
        return push_down(self.rule, conditions)

    def _place(self, name: str) -> tuple[int, str]:
        """The part, by number, and the attribute of `need.attribute`."""
        need, _, attribute = name.partition(".")
        return self._needs.index(need), attribute

    def cost(self, parts: Iterable[float]) -> float:
        return self._ranking.whole(parts, self.rule.loss)

    def least_cost(self, costs: Mapping[str, float]) -> float | None:
        """The least cost of the whole for these costs of primitives; None when a primitive is missing."""
        found = [costs.get(need.primitive) for need in self.rule.needs.values()]
        known = [cost for cost in found if cost is not None]
        return self.cost(known) if len(known) == len(found) else None

    def combinations(
        self, streams: Sequence[PlanStream], narrowed: PushedDown, effort: SearchBudget
    ) -> Iterable[tuple[Plan, ...]]:
        """The choices of parts that fit together, the best first. Raises SearchBudgetExceeded."""
        return BestFirstJoin(streams, self.cost, effort, narrowed.joins, narrowed.checks, self._distinct)

    def conflicts(self, parts: Sequence[Plan]) -> tuple[str, ...]:
        """The reasons why the parts do not fit together; () when they do."""
        facts, reason_of = self._facts(parts), self._unknown_reasons(parts)
        found = [
            reason for condition in self.rule.where for reason in failure_reasons(condition, facts, reason_of)
        ]
        return (*found, *self._shared(parts))

    def _shared(self, parts: Sequence[Plan]) -> Iterator[str]:
        """The parts that must be distinct and have an agent in common."""
        for first, second in combinations(sorted(self._distinct), 2):
            if both := parts[first].agents & parts[second].agents:
                yield f"{self._needs[first]} and {self._needs[second]} are both {listed(sorted(both))}"

    def _facts(self, parts: Sequence[Plan]) -> dict[str, Value]:
        """The facts that the rule's expressions use: of the parts, and of the composition."""
        facts: dict[str, Value] = {}
        for name, index, attribute in self._inputs:
            value = parts[index].values.get(attribute)
            if value is not None:
                facts[name] = value
        return facts | {
            name: value for name, judge, _ in self._attributes if (value := judge(facts)) is not None
        }

    def plan(self, parts: Sequence[Plan]) -> Plan:
        """The whole of parts that fit together."""
        facts = self._facts(parts)
        values = {name: facts[name] for name, _, _ in self._attributes if name in facts}
        values["agent"] = _joined([part.values["agent"] for part in parts])
        values["robot"] = values["host"] = _joined([part.values["host"] for part in parts])
        reason_of = self._unknown_reasons(parts)
        unknown = {name: reason_of(name) for name, _, _ in self._attributes if name not in facts}
        cost = self.cost([part.cost for part in parts])
        rank = (cost, 1, (self.rule.name,), tuple(part.rank for part in parts))
        return Plan(self._offer, (parts, facts), rank, values, unknown, self.rule.name)

    def _offer(self, plan: Plan) -> Offer:
        parts, facts = plan.inputs
        rule, offers = self.rule, [part.offer for part in parts]
        common_facts = {
            name: self._fact(facts[name], fact_names(expression), offers)
            for name, _, expression in self._attributes
            if name in facts
        }
        return Offer(
            rule.serves,
            "composed",
            self._field,
            _listed(offer.agent for offer in offers),
            _listed(offer.host for offer in offers),
            plan.cost,
            common_facts,
            dict(zip(self._fields, offers, strict=True)),
            rule.name,
            self._ranking.terms(ONE_TO_MANY, [rule.loss, len(parts) - 1]),
        )

    def _fact(self, value: Value, inputs: Sequence[str], offers: Sequence[Offer]) -> Fact:
        """A value of the whole: as old as its oldest source, and as reliable as the least reliable."""
        places = [self._place(name) for name in inputs]
        found = [fact for index, name in places if (fact := offers[index].facts.get(name)) is not None]
        weakest: Provenance = next(
            (provenance for provenance in _SURER if any(fact.of == provenance for fact in found)), "stated"
        )
        return Fact(value, max((fact.age for fact in found), default=0.0), weakest)

    def _unknown_reasons(self, parts: Sequence[Plan]) -> Callable[[str], str]:
        """The reason why an attribute of a part, or of the whole, has no value."""

        def reason_of(name: str) -> str:
            if "." not in name:
                facts = self._facts(parts)
                lacking = [n for n in fact_names(self.rule.attributes[name]) if n not in facts]
                return ", ".join([f"{name} is not known", *dict.fromkeys(map(reason_of, lacking))])
            index, attribute = self._place(name)
            if attribute in POSITION:
                return f"the position of {self._needs[index]} is not known{_in_part(parts[index])}"
            return f"of {self._needs[index]}, {parts[index].unknown_reason(attribute)}"

        return reason_of


def _in_part(part: Plan) -> str:
    """The unknown coordinates of a position of which the rest is known."""
    lacking = [axis for axis in POSITION if axis not in part.values]
    return f": {', '.join(map(part.unknown_reason, lacking))}" if len(lacking) < len(POSITION) else ""


def _joined(found: Sequence[Value]) -> Value:
    """Names of several parts: one when all are the same, else the set of them."""
    members: frozenset[str] = frozenset()
    for value in found:
        members |= value if isinstance(value, frozenset) else {str(value)}
    return next(iter(members)) if len(members) == 1 else members


def _listed(found: Iterable[str]) -> str:
    """The same for people, in the order of the needs."""
    return "+".join(dict.fromkeys(name for names in found for name in names.split("+")))
