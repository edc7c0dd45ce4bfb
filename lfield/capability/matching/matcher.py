"""The query engine: offers of a primitive, best first, and the reasons why other agents are not offered."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from msgspec import Struct

from lfield.capability.matching.best_first_join import PlanStream, SearchBudget, SearchBudgetExceeded, teams
from lfield.capability.matching.condition_evaluator import evaluator, fact_names
from lfield.capability.matching.explanation import TOO_MANY, Explanation, partial_search_note
from lfield.capability.matching.plan import Plan
from lfield.capability.matching.plan_search import Search, SearchLimits
from lfield.capability.matching.rule_index import RuleIndex
from lfield.capability.model import ANY_OFFER, Expression, OfferQuery, Registry, SortKey
from lfield.capability.offer import AgentSource, Offer, Rejection


class MatchResult(Struct, frozen=True):
    """The best offers, best first; the number of all offers; and notes on omissions of the search.

    For `cut` rules not all combinations of parts could be tried: there may be more offers, and better ones.
    Of `full` rules only the best `per_rule` are offered. `unordered` are attributes of the `order by` that no
    agent has.
    """

    offers: Sequence[Offer]
    count: int
    cut: tuple[str, ...] = ()
    unordered: tuple[str, ...] = ()
    full: tuple[str, ...] = ()
    per_rule: int = 0

    @property
    def notes(self) -> list[str]:
        """The omissions of the search, a sentence each."""
        found = [
            f"{rule}: {partial_search_note(self.per_rule)}" for rule in self.full if rule not in self.cut
        ]
        if self.count > len(self.offers):
            at_least = "at least " if self.cut else ""
            found.append(f"the best {len(self.offers)} of {at_least}{self.count} offers are given")
        return found + self._caveats()

    def summary(self, agents: int) -> list[str]:
        """The number of offers and agents, and the omissions."""
        if self.count == 0 or self.count > len(self.offers):
            return self.notes
        offers = "there is 1 offer" if self.count == 1 else f"there are {self.count} offers"
        return [f"{offers}, by {agents} agent{'s' if agents > 1 else ''}", *self.notes]

    def _caveats(self) -> list[str]:
        found = [f"no agent has a value of {name}: offers are not ordered by it" for name in self.unordered]
        found += [f"{rule}: {TOO_MANY}" for rule in self.cut]
        return found


class TeamResult(Struct, frozen=True):
    """Teams of offers, best first, members best first; and the number of candidate agents.

    `others`: there are further teams. For the `cut` rules not all combinations of parts were tried; `more`:
    nor all combinations of members. For the `full` rules only the best combinations were candidates.
    """

    teams: Sequence[Sequence[Offer]]
    agents: int
    cut: tuple[str, ...] = ()
    more: bool = False
    full: tuple[str, ...] = ()
    others: bool = False

    @property
    def notes(self) -> list[str]:
        """The omissions of the search, a sentence each."""
        found = [f"the best {len(self.teams)} of more teams are given"] if self.others else []
        found += [f"{rule}: {TOO_MANY}" for rule in self.cut]
        found += [f"{rule}: only the best combinations can be in a team" for rule in self.full]
        return [*found, "more teams exist than could be tried"] if self.more else found


class Matcher:
    """Evaluates queries on the directory of one host, without communication.

    `realisations` restricts the answers to the fields that a program was compiled with, by primitive
    (realisations.py). Candidates that are the same objects as in the last query are not evaluated again.
    """

    def __init__(
        self,
        registry: Registry,
        team: AgentSource,
        realisations: Mapping[str, Collection[str]] | None = None,
        limits: SearchLimits | None = None,
    ) -> None:
        self._limits = limits or SearchLimits()
        #: The number of offers if the query has no limit.
        self.max_offers = self._limits.offers
        self._team = team
        self._rules = RuleIndex(registry, team.candidates, realisations, self._limits.depth)

    def find(self, primitive: str, query: OfferQuery = ANY_OFFER) -> MatchResult:
        """The best offers for a query, at most its limit or `max_offers`.

        Ties are ordered by the number of rules, the names of the rules, the first part, and the order of the
        deployment. Each composition rule gives at most `limits.per_rule` offers.
        """
        search = self._search(primitive, query)
        limit = query.limit or self.max_offers
        if query.order:
            plans, unordered = self._ordered(search, query.order)
            count = len(plans)
        else:
            plans, unordered = list(islice(search.plans(), limit)), ()
            count = len(plans) if len(plans) < limit else max(len(plans), search.count())
        offers = [plan.offer for plan in plans[:limit]]
        cut, full = (tuple(sorted(names)) for names in (search.cut, search.full))
        return MatchResult(offers, count, cut, unordered, full, self._limits.per_rule)

    def offers(self, primitive: str, constraint: Expression | None = None) -> Sequence[Offer]:
        """The best offers of a primitive that satisfy a condition."""
        return self.find(primitive, OfferQuery(constraint)).offers

    def count(self, primitive: str, constraint: Expression | None = None) -> int:
        """The number of all offers of which `offers` returns the best."""
        return self.find(primitive, OfferQuery(constraint)).count

    def teams(self, primitive: str, size: int, query: OfferQuery = ANY_OFFER) -> TeamResult:
        """The best teams of `size` offers without a common agent.

        Of several offers by the same agents only the best can be a member. The cost of a team is the sum of
        the costs of its members plus `part` for each after the first; ties are ordered by the first member,
        then the second. If the query has an order, teams are compared by their members.
        """
        search = self._search(primitive, query)
        cost: Callable[[Iterable[float]], float]
        if query.order:
            members, cost = PlanStream(_by_agents(self._ordered(search, query.order)[0])), _no_cost
        else:
            members, cost = PlanStream(_by_agents(search.plans())), self._rules.ranking.whole
        offer_teams, more = [], False
        limit = query.limit or self.max_offers
        try:
            effort = SearchBudget(self._limits.failures, self._limits.steps)
            for team in islice(teams(members, size, cost, effort), limit + 1):
                offer_teams.append([plan.offer for plan in team])
        except SearchBudgetExceeded:
            more = True
        agents = len(_agents(members.all()))
        cut, full = (tuple(sorted(names)) for names in (search.cut, search.full))
        return TeamResult(offer_teams[:limit], agents, cut, more, full, len(offer_teams) > limit)

    def agents(self, primitive: str, query: OfferQuery = ANY_OFFER) -> int:
        """The number of agents that take part in any offer."""
        return len(_agents(self._search(primitive, query).plans()))

    def explain(self, primitive: str, constraint: Expression | None = None) -> list[Rejection]:
        """The possible providers that are not offered: agents of each realisation, and rules."""
        return Explanation(self._search(primitive, OfferQuery(constraint))).refusals()

    def _search(self, primitive: str, query: OfferQuery) -> Search:
        sort_facts = [name for key in query.order for name in fact_names(key.value)]
        return Search(self._rules, self._team, self._limits, primitive, query.condition, sort_facts)

    def _ordered(self, search: Search, keys: Sequence[SortKey]) -> tuple[list[Plan], tuple[str, ...]]:
        """All plans by some keys, then by their ranks; and the keys of which no agent has a value."""
        values = [evaluator(key.value) for key in keys]
        has_values = [False] * len(keys)

        def place(plan: Plan) -> tuple[Any, ...]:
            found: list[tuple[bool, Any]] = []
            for number, (key, value) in enumerate(zip(keys, values, strict=True)):
                amount: Any = value(plan.values)
                has_values[number] = has_values[number] or amount is not None
                found.append((amount is None, 0 if amount is None else -amount if key.descending else amount))
            return (*found, plan.rank)

        plans = sorted(search.every_plan(), key=place)
        unordered = [
            key.value.text for key, is_known in zip(keys, has_values, strict=True) if plans and not is_known
        ]
        count_by_rule: Counter[str] = Counter()
        best = []
        for plan in plans:
            count_by_rule[plan.composition] += 1
            if not plan.composition or count_by_rule[plan.composition] <= self._limits.per_rule:
                best.append(plan)
            else:
                search.full.add(plan.composition)
        return best, tuple(unordered)


def _by_agents(plans: Iterable[Plan]) -> Iterator[Plan]:
    """The first of the plans with the same agents, for each set of agents."""
    known: set[frozenset[str]] = set()
    for plan in plans:
        if plan.agents not in known:
            known.add(plan.agents)
            yield plan


def _agents(plans: Iterable[Plan]) -> frozenset[str]:
    return frozenset[str]().union(*(plan.agents for plan in plans))


def _no_cost(costs: Iterable[float]) -> float:
    return 0.0
