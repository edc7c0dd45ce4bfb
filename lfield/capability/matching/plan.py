"""A way to do it: an offer together with what conditions are judged on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

from lfield.capability import ways
from lfield.capability.matching.evaluate import Facts, Judge
from lfield.capability.matching.ranking import Ranking
from lfield.capability.model import Equivalence
from lfield.capability.offer import Offer


@dataclass(slots=True, eq=False)
class Plan:
    """An offer, its cost, and its attributes as flat facts with `agent`, `robot` and `host`.

    Where a plan takes several agents, the three are sets. `unknown` tells of attributes why they have no
    value. `composition` is the rule that puts several parts together, '' when it is one agent. The offer
    itself is made by `make` when it is asked for: most plans of a search are not offered in the end.
    """

    make: Callable[[], Offer]
    cost: float
    values: Facts
    unknown: Mapping[str, str]
    composition: str = ""
    _offer: Offer | None = None

    @property
    def offer(self) -> Offer:
        """What the matcher gives, made once."""
        if self._offer is None:
            self._offer = self.make()
        return self._offer

    def why(self, name: str) -> str:
        """Why an attribute has no value."""
        return self.unknown.get(name) or f"{name} is not stated"


def fulfilling(plans: Iterable[Plan], judges: Sequence[Judge]) -> Iterator[Plan]:
    """Those of which all conditions are true, one by one; one that is unknown is not."""
    # Written out, because a thousand plans go through here in a query.
    for plan in plans:
        values = plan.values
        for judge in judges:
            if judge(values) is not True:
                break
        else:
            yield plan


#: The same few names are asked for with every offer.
_way = cache(ways.equivalent)


def standing_in(rule: Equivalence, behind: Plan, ranking: Ranking) -> Plan:
    """The plan by a one-to-one rule, from one for what the rule asks."""
    cost = ranking.by_rule(behind.cost, rule.loss)
    make = partial(_equivalent, rule, behind, cost)
    return Plan(make, cost, behind.values, behind.unknown, behind.composition)


def _equivalent(rule: Equivalence, behind: Plan, cost: float) -> Offer:
    inner, way = behind.offer, _way(rule.name)
    return Offer(
        rule.serves,
        "equivalent",
        way,
        inner.agent,
        inner.host,
        cost,
        inner.facts,
        {way: inner},
        rule.name,
    )
