"""Who can do it now, best first, and why the others cannot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

from lfield.capability.matching.evaluate import evaluator, names
from lfield.capability.matching.explain import TOO_MANY, Explanation, only_best
from lfield.capability.matching.joining import Effort, GivenUp, Stream, teams
from lfield.capability.matching.plan import Plan
from lfield.capability.matching.rules import Rules
from lfield.capability.matching.search import Limits, Search
from lfield.capability.model import ANYBODY, Expression, Key, Registry, Wish
from lfield.capability.offer import Offer, Refusal, Team


@dataclass(frozen=True, slots=True)
class Answer:
    """The best offers, best first; how many there are; and what the search left out, in words.

    Of `cut` rules not all combinations of parts could be tried: there may be more offers, and better ones. Of
    `full` rules only the best `per_rule` are offered.
    `unordered` are attributes that nobody states and by which was to be ordered.
    """

    offers: Sequence[Offer]
    count: int
    cut: tuple[str, ...] = ()
    unordered: tuple[str, ...] = ()
    full: tuple[str, ...] = ()
    per_rule: int = 0

    @property
    def notes(self) -> list[str]:
        """What was left out, a sentence each."""
        found = [f"{rule}: {only_best(self.per_rule)}" for rule in self.full if rule not in self.cut]
        if self.count > len(self.offers):
            least = "at least " if self.cut else ""
            found.append(f"the best {len(self.offers)} of {least}{self.count} offers are given")
        return found + self._doubts()

    def summary(self, agents: int) -> list[str]:
        """How many offers there are, of so many agents, and what was left out."""
        if self.count == 0 or self.count > len(self.offers):
            return self.notes
        offers = "there is 1 offer" if self.count == 1 else f"there are {self.count} offers"
        return [f"{offers}, by {agents} agent{'s' if agents > 1 else ''}", *self.notes]

    def _doubts(self) -> list[str]:
        found = [f"{name} is known of nobody: it orders nothing" for name in self.unordered]
        found += [f"{rule}: {TOO_MANY}" for rule in self.cut]
        return found


@dataclass(frozen=True, slots=True)
class Teams:
    """Teams of offers, best first, the members of each best first; how many agents there are for one.

    There are `others` that are not given. Of `cut` rules not all combinations of parts could be tried, nor of
    the members if there are `more`. Of `full` rules only the best so many combinations could be members.
    """

    teams: Sequence[Sequence[Offer]]
    agents: int
    cut: tuple[str, ...] = ()
    more: bool = False
    full: tuple[str, ...] = ()
    others: bool = False

    @property
    def notes(self) -> list[str]:
        """What was left out, a sentence each."""
        found = [f"the best {len(self.teams)} of more teams are given"] if self.others else []
        found += [f"{rule}: {TOO_MANY}" for rule in self.cut]
        found += [f"{rule}: only the best combinations can be in a team" for rule in self.full]
        return [*found, "there are more teams than could be tried"] if self.more else found


class Matcher:
    """Answers questions from what one host knows; nothing is sent.

    `ways` restricts the answers to the fields that a program was compiled with, by primitive (ways.py).
    Candidates that are the same objects as in the last query are not looked at again.
    """

    def __init__(
        self,
        registry: Registry,
        team: Team,
        ways: Mapping[str, Collection[str]] | None = None,
        limits: Limits | None = None,
    ) -> None:
        self._limits = limits or Limits()
        #: So many offers are given where the question does not say.
        self.most = self._limits.offers
        self._team = team
        self._rules = Rules(registry, team.candidates, ways, self._limits.depth)

    def find(self, primitive: str, wish: Wish = ANYBODY) -> Answer:
        """The best who serve the primitive as is asked, at most as many as is asked or `most`.

        Ties go to the way with fewer rules, then by the names of rules, then to the better first part, and at
        last by the order of the deployment. Of each composition there are the best `limits.per_rule`.
        """
        search = self._search(primitive, wish)
        most = wish.limit or self.most
        if wish.order:
            plans, unordered = self._ordered(search, wish.order)
            count = len(plans)
        else:
            plans, unordered = list(islice(search.plans(), most)), ()
            count = len(plans) if len(plans) < most else max(len(plans), search.count())
        offers = [plan.offer for plan in plans[:most]]
        cut, full = (tuple(sorted(names)) for names in (search.cut, search.full))
        return Answer(offers, count, cut, unordered, full, self._limits.per_rule)

    def offers(self, primitive: str, constraint: Expression | None = None) -> Sequence[Offer]:
        """The best who serve the primitive and fulfil a condition."""
        return self.find(primitive, Wish(constraint)).offers

    def count(self, primitive: str, constraint: Expression | None = None) -> int:
        """How many there are of whom `offers` gives the best."""
        return self.find(primitive, Wish(constraint)).count

    def teams(self, primitive: str, size: int, wish: Wish = ANYBODY) -> Teams:
        """The best teams of so many offers that have no agent in common.

        Of offers by the same agents only the best can be a member. A team costs the sum of what its members
        cost, and `part` for each after the first; of equal cost goes that with the better first member first,
        then the second. Where the question orders, teams are compared by their members alone.
        """
        search = self._search(primitive, wish)
        cost: Callable[[Iterable[float]], float]
        if wish.order:
            members, cost = Stream(_by_agents(self._ordered(search, wish.order)[0])), _no_cost
        else:
            members, cost = Stream(_by_agents(search.plans())), self._rules.ranking.whole
        found, more = [], False
        most = wish.limit or self.most
        try:
            effort = Effort(self._limits.tried, self._limits.steps)
            for team in islice(teams(members, size, cost, effort), most + 1):
                found.append([plan.offer for plan in team])
        except GivenUp:
            more = True
        agents = len(_agents(members.all()))
        cut, full = (tuple(sorted(names)) for names in (search.cut, search.full))
        return Teams(found[:most], agents, cut, more, full, len(found) > most)

    def agents(self, primitive: str, wish: Wish = ANYBODY) -> int:
        """How many agents take part in any offer."""
        return len(_agents(self._search(primitive, wish).plans()))

    def explain(self, primitive: str, constraint: Expression | None = None) -> list[Refusal]:
        """Everyone who could serve the primitive and is not offered: each agent of each way, each rule."""
        return Explanation(self._search(primitive, Wish(constraint))).refusals()

    def _search(self, primitive: str, wish: Wish) -> Search:
        looked_at = [name for key in wish.order for name in names(key.value)]
        return Search(self._rules, self._team, self._limits, primitive, wish.condition, looked_at)

    def _ordered(self, search: Search, keys: Sequence[Key]) -> tuple[list[Plan], tuple[str, ...]]:
        """All plans by some keys, then by their ranks; and what of the keys is known of nobody."""
        values = [evaluator(key.value) for key in keys]
        known = [False] * len(keys)

        def place(plan: Plan) -> tuple[Any, ...]:
            found: list[tuple[bool, Any]] = []
            for number, (key, value) in enumerate(zip(keys, values, strict=True)):
                amount: Any = value(plan.values)
                known[number] = known[number] or amount is not None
                found.append((amount is None, 0 if amount is None else -amount if key.descending else amount))
            return (*found, plan.rank)

        plans = sorted(search.every_plan(), key=place)
        unordered = [
            key.value.text for key, is_known in zip(keys, known, strict=True) if plans and not is_known
        ]
        given: Counter[str] = Counter()
        best = []
        for plan in plans:
            given[plan.composition] += 1
            if not plan.composition or given[plan.composition] <= self._limits.per_rule:
                best.append(plan)
            else:
                search.full.add(plan.composition)
        return best, tuple(unordered)


def _by_agents(plans: Iterable[Plan]) -> Iterator[Plan]:
    """Of the plans with the same agents the first."""
    seen: set[frozenset[str]] = set()
    for plan in plans:
        if plan.agents not in seen:
            seen.add(plan.agents)
            yield plan


def _agents(plans: Iterable[Plan]) -> frozenset[str]:
    return frozenset[str]().union(*(plan.agents for plan in plans))


def _no_cost(costs: Iterable[float]) -> float:
    return 0.0
