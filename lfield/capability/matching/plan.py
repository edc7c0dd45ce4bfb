"""A plan: an offer together with the facts for its conditions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from msgspec import Struct

from lfield.capability import realisations
from lfield.capability.matching.condition_evaluator import Facts, Judge
from lfield.capability.matching.ranking import ONE_TO_ONE, Ranking
from lfield.capability.model import Equivalence
from lfield.capability.offer import Offer

#: The cost, the number of rules that lead to the agent or the whole, their names, and the end of the chain:
#: the number of the agent in the deployment, or the ranks of the parts, one by one.
Rank = tuple[float, int, tuple[str, ...], tuple[Any, ...]]


class Plan(Struct, eq=False):
    """A candidate offer: its rank, and its attributes as flat facts with `agent`, `robot` and `host`.

    Plans are offered in the order of their ranks. For a plan with several agents the three are sets.
    `unknown` has the reasons for attributes without a value. `composition` is the rule that combines several
    parts, '' for a single agent. `make` creates the offer from the plan and `inputs` on demand, because most
    plans are not offered.
    """

    make: Callable[[Plan], Offer]
    inputs: tuple[Any, ...]
    rank: Rank
    values: Facts
    unknown: Mapping[str, str]
    composition: str = ""
    _offer: Offer | None = None

    @property
    def cost(self) -> float:
        """The cost: the less, the better."""
        return self.rank[0]

    @property
    def agents(self) -> frozenset[str]:
        found = self.values["agent"]
        return found if isinstance(found, frozenset) else frozenset((str(found),))

    @property
    def offer(self) -> Offer:
        """The offer of the plan, made once."""
        if self._offer is None:
            self._offer = self.make(self)
        return self._offer

    def unknown_reason(self, name: str) -> str:
        """The reason why an attribute has no value."""
        return self.unknown.get(name) or f"{name} is not stated"

    def source(self, name: str) -> str:
        """The source of the value of an attribute, if it is not simply stated: ` (nominal)`."""
        fact = self.offer.facts.get(name)
        return "" if fact is None or fact.of == "stated" else f" ({fact.source})"


def satisfying(plans: Iterable[Plan], judges: Sequence[Judge]) -> Iterator[Plan]:
    """The plans of which all conditions are true, one by one; an unknown condition is not true."""
    # Written out, because a thousand plans go through here in a query.
    for plan in plans:
        values = plan.values
        for judge in judges:
            if judge(values) is not True:
                break
        else:
            yield plan


#: Cached, because every offer uses the same few names.
_field = cache(realisations.equivalent)


def substitute(rule: Equivalence, behind: Plan, ranking: Ranking) -> Plan:
    """The plan by a one-to-one rule, from one for the need of the rule."""
    cost, rules, names, end = behind.rank
    cost = ranking.by_rule(cost, rule.loss)
    rank = (cost, rules + 1, (rule.name, *names), end)
    inputs = rule, behind, ranking
    return Plan(_equivalent, inputs, rank, behind.values, behind.unknown, behind.composition)


def _equivalent(plan: Plan) -> Offer:
    rule, behind, ranking = plan.inputs
    inner, field = behind.offer, _field(rule.name)
    return Offer(
        rule.serves,
        "equivalent",
        field,
        inner.agent,
        inner.host,
        plan.cost,
        inner.facts,
        {field: inner},
        rule.name,
        ranking.terms(ONE_TO_ONE, [rule.loss]),
    )
