"""Lazy best-first search over an AND/OR graph of plans.

A primitive is served by one of its realisations (OR), a composition by all of its parts (AND). Every node is
a lazy stream of plans in the order of their cost. A primitive merges them by a heap with a lower bound of the
cost of each, so that expensive ones are never started; a composition joins its parts by the sum of their
costs. Nodes are shared: each is computed once for a primitive and the number of rules that may still be
chained.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain as joined
from itertools import islice

from msgspec import Struct

from lfield.capability.matching.assembly import Assembly
from lfield.capability.matching.best_first_join import (
    BestFirstJoin,
    PlanStream,
    SearchBudget,
    SearchBudgetExceeded,
)
from lfield.capability.matching.condition_evaluator import Judge, conjuncts, evaluator, fact_names
from lfield.capability.matching.plan import Plan, Rank, satisfying, substitute
from lfield.capability.matching.provider_plans import CostContext
from lfield.capability.matching.pushdown import PushedDown
from lfield.capability.matching.rule_index import Chain, RuleIndex, least_costs
from lfield.capability.model import Expression, Need
from lfield.capability.offer import AgentSource, Candidate

#: Conditions that must all be true of a plan.
Conditions = tuple[Expression, ...]
#: The compositions that contain a plan.
Used = frozenset[str]

NOTHING: Used = frozenset()


class SearchLimits(Struct, frozen=True):
    """Limits of a search.

    depth           rules on top of one another
    per_rule        offers of each composition
    combinations    failed combinations of parts of one composition
    failures        failed combinations in total
    steps           chosen parts in total
    offers          returned offers, the best ones
    """

    depth: int = 4
    per_rule: int = 16
    combinations: int = 1_000
    failures: int = 2_000
    steps: int = 20_000
    offers: int = 32


class _Route(Struct, frozen=True):
    """A chain of one-to-one rules with agents or a composition at its end; it costs at least `bound`."""

    chain: Chain
    assembly: Assembly | None
    bound: float

    @property
    def names(self) -> tuple[str, ...]:
        """The rules of the realisation, in their order for ties."""
        whole = () if self.assembly is None else (self.assembly.rule.name,)
        return (*(rule.name for rule in self.chain), *whole)


class Search:
    """One query for a primitive, for the present state of the team.

    Attributes that are `also_named` count for the age of an agent as those of the constraint do.
    """

    def __init__(
        self,
        rules: RuleIndex,
        team: AgentSource,
        limits: SearchLimits,
        primitive: str,
        constraint: Expression | None,
        also_named: Iterable[str] = (),
    ) -> None:
        self.rules, self.limits = rules, limits
        self.primitive, self.constraint = primitive, constraint
        self.conditions: Conditions = () if constraint is None else conjuncts(constraint)
        #: The parts of the query that affect the cost of an agent.
        self.context = CostContext(attributes_of(constraint).union(also_named), team.location())
        #: Compositions of which not all combinations were tried.
        self.cut: set[str] = set()
        #: Compositions of which only the best are offered.
        self.full: set[str] = set()
        self._team = team
        self._budget = SearchBudget(limits.failures, limits.steps)
        self._candidates: dict[str, Sequence[Candidate]] = {}
        self._agents: dict[str, list[Plan]] = {}
        self._streams: dict[tuple[str, int, Used, Conditions], PlanStream] = {}
        self._composed: dict[tuple[str, int, Used, Conditions], PlanStream] = {}
        self._least_costs = least_costs(rules, primitive, self._cheapest)

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, read once."""
        if resource not in self._candidates:
            self._candidates[resource] = self._team.candidates(resource)
        return self._candidates[resource]

    def agents(self, primitive: str) -> list[Plan]:
        """The agents that serve a primitive themselves, the best first."""
        if primitive not in self._agents:
            found = [
                provided.plans(self.candidates(provided.type), self.context)
                for provided in self.rules.providers(primitive)
            ]
            # In the order of the deployment first: of equal cost that counts, and types are in it already.
            plans = found[0] if len(found) == 1 else sorted(joined(*found), key=_number)
            self._agents[primitive] = sorted(plans, key=_cost)
        return self._agents[primitive]

    def plans(self) -> Iterator[Plan]:
        """All plans that fulfil the constraint, the best first; of each composition the best."""
        counts: Counter[str] = Counter()
        found = []
        for route in self._routes(self.primitive, self.limits.depth, NOTHING):
            plans = self._plans(route, self.primitive, self.limits.depth, NOTHING, self.conditions)
            if route.assembly is not None:
                plans = self._capped(plans, route.assembly, counts)
            found.append((route.bound, plans))
        for plan in _merged(found):
            if not plan.composition:
                yield plan
            elif counts[plan.composition] < self.limits.per_rule:
                counts[plan.composition] += 1
                yield plan

    def count(self) -> int:
        """The number of `plans`, without making those of single agents."""
        wholes: dict[str, list[Iterator[Plan]]] = {}
        total = 0
        for route in self._routes(self.primitive, self.limits.depth, NOTHING):
            if route.assembly is None:
                agents = self.agents(_end(route.chain, self.primitive))
                rule_conditions = _rule_conditions(route.chain)
                plans = satisfying(agents, judges((*rule_conditions, *self.conditions)))
                total += sum(1 for _ in plans) if rule_conditions or self.conditions else len(agents)
            else:
                plans = self._plans(route, self.primitive, self.limits.depth, NOTHING, self.conditions)
                wholes.setdefault(route.assembly.rule.name, []).append(plans)
        limit = self.limits.per_rule
        return total + sum(len(list(islice(joined(*plans), limit))) for plans in wholes.values())

    def every_plan(self) -> Iterator[Plan]:
        """All plans that fulfil the constraint, of compositions as many as may be tried; in no order."""
        for route in self._routes(self.primitive, self.limits.depth, NOTHING):
            plans = self._plans(route, self.primitive, self.limits.depth, NOTHING, self.conditions)
            if route.assembly is None:
                yield from plans
                continue
            yield from islice(plans, self.limits.combinations)
            if next(plans, None) is not None:
                self.cut.add(route.assembly.rule.name)

    def _capped(self, plans: Iterator[Plan], assembly: Assembly, counts: Counter[str]) -> Iterator[Plan]:
        """The plans, until enough of the composition were given, here or by other chains."""
        while counts[assembly.rule.name] < self.limits.per_rule:
            plan = next(plans, None)
            if plan is None:
                return
            yield plan
        if next(plans, None) is not None:
            self.full.add(assembly.rule.name)

    def has_plan(self, primitive: str, chain: Chain, depth: int, used: Used, conditions: Conditions) -> bool:
        """Whether any plan uses a chain that begins with this one."""
        found = (
            route for route in self._routes(primitive, depth, used) if route.chain[: len(chain)] == chain
        )
        plans = (self._plans(route, primitive, depth, used, conditions) for route in found)
        return next(joined.from_iterable(plans), None) is not None

    def plan_stream(self, primitive: str, depth: int, used: Used, conditions: Conditions = ()) -> PlanStream:
        """All plans for a primitive that fulfil the wishes; `used` are the compositions it is part of."""
        # Compositions that cannot occur below are removed, so that the node can be shared.
        used &= self.rules.inside(primitive)
        node = (primitive, depth, used, conditions)
        if node not in self._streams:
            found = self._routes(primitive, depth, used)
            plans = _merged(
                [(route.bound, self._plans(route, primitive, depth, used, conditions)) for route in found]
            )
            self._streams[node] = PlanStream(plans)
        return self._streams[node]

    def composed(self, assembly: Assembly, depth: int, used: Used, conditions: Conditions = ()) -> PlanStream:
        """The valid combinations of parts, with at most `depth` rules below the composition's own."""
        used &= self.rules.inside(assembly.rule.serves)
        node = (assembly.rule.name, depth, used, conditions)
        if node not in self._composed:
            self._composed[node] = PlanStream(self._fitting(assembly, depth, used, conditions))
        return self._composed[node]

    def plans_for_need(self, assembly: Assembly, need: Need, depth: int, used: Used) -> PlanStream:
        """The plans for one part of a composition, independent of the conditions on the whole."""
        conditions = () if need.when is None else conjuncts(need.when)
        return self.plan_stream(need.primitive, depth, used | {assembly.rule.name}, conditions)

    def combinations(self, assembly: Assembly, depth: int, used: Used) -> Iterator[tuple[Plan, ...]]:
        """Every choice of parts, the cheapest first, also those that do not fit together."""
        streams = [self.plans_for_need(assembly, need, depth, used) for need in assembly.rule.needs.values()]
        return iter(
            BestFirstJoin(streams, assembly.cost, SearchBudget(self.limits.combinations, self.limits.steps))
        )

    def _cheapest(self, primitive: str) -> float | None:
        found = self.agents(primitive)
        return found[0].cost if found else None

    def _fitting(self, assembly: Assembly, depth: int, used: Used, conditions: Conditions) -> Iterator[Plan]:
        """The wholes that fulfil the wishes, the best first."""
        effort = SearchBudget(self.limits.combinations, self.limits.steps, self._budget)
        branches = [
            (0.0, self._branch(assembly, narrowed, depth, used | {assembly.rule.name}, effort))
            for narrowed in assembly.pushed_down(conditions)
        ]
        yield from _merged(branches)

    def _branch(
        self, assembly: Assembly, narrowed: PushedDown, depth: int, used: Used, effort: SearchBudget
    ) -> Iterator[Plan]:
        needs = assembly.rule.needs.values()
        streams = [
            self.plan_stream(need.primitive, depth, used, conditions)
            for need, conditions in zip(needs, narrowed.parts, strict=True)
        ]
        whole = judges(narrowed.whole)
        try:
            for parts in assembly.combinations(streams, narrowed, effort):
                plan = assembly.plan(parts)
                if all(judge(plan.values) is True for judge in whole):
                    yield plan
                elif not effort.fail():
                    raise SearchBudgetExceeded
        except SearchBudgetExceeded:
            self.cut.add(assembly.rule.name)

    def _routes(self, primitive: str, depth: int, used: Used) -> list[_Route]:
        """All realisations of a primitive, in the order in which they win ties."""
        routes = []
        for chain in self.rules.chains(primitive):
            if len(chain) > depth:
                break
            end = _end(chain, primitive)
            if own := self.agents(end):
                routes.append(_Route(chain, None, self._by_chain(chain, own[0].cost)))
            for assembly in self.rules.compositions(end) if len(chain) < depth else ():
                least_cost = assembly.least_cost(self._least_costs)
                if least_cost is not None and assembly.rule.name not in used:
                    routes.append(_Route(chain, assembly, self._by_chain(chain, least_cost)))
        return sorted(routes, key=lambda route: (len(route.names), route.names))

    def _by_chain(self, chain: Chain, cost: float) -> float:
        """The cost of an offer by a chain, from the cost at its end."""
        for rule in reversed(chain):
            cost = self.rules.ranking.by_rule(cost, rule.loss)
        return cost

    def _plans(
        self, route: _Route, primitive: str, depth: int, used: Used, conditions: Conditions
    ) -> Iterator[Plan]:
        """The plans of one realisation that fulfil the conditions of its rules and of the query."""
        all_conditions = (*_rule_conditions(route.chain), *conditions)
        behind: Iterable[Plan]
        if route.assembly is None:
            behind = satisfying(self.agents(_end(route.chain, primitive)), judges(all_conditions))
        else:
            behind = _each(self.composed(route.assembly, depth - len(route.chain) - 1, used, all_conditions))
        for plan in behind:
            for rule in reversed(route.chain):
                plan = substitute(rule, plan, self.rules.ranking)
            yield plan


def judges(conditions: Iterable[Expression]) -> list[Judge]:
    """One function for each condition."""
    return [evaluator(condition) for condition in conditions]


def attributes_of(condition: Expression | None) -> frozenset[str]:
    """The attributes in a condition."""
    return frozenset() if condition is None else frozenset(fact_names(condition))


def _rule_conditions(chain: Chain) -> Conditions:
    """The conditions of the rules of a chain on the agent at its end."""
    return tuple(c for rule in chain if rule.when is not None for c in conjuncts(rule.when))


def _end(chain: Chain, primitive: str) -> str:
    return chain[-1].by if chain else primitive


def _cost(plan: Plan) -> float:
    return plan.rank[0]


def _number(plan: Plan) -> int:
    number: int = plan.rank[3][0]
    return number


def _each(stream: PlanStream) -> Iterator[Plan]:
    """The plans of a stream, on demand."""
    number = 0
    while (plan := stream.at(number)) is not None:
        yield plan
        number += 1


def _merged(streams: Iterable[tuple[float, Iterator[Plan]]]) -> Iterator[Plan]:
    """Merges ordered streams of plans by rank; ties by the order of the streams.

    A stream that was not read yet has a lower bound of its cost as key.
    """
    started = list(streams)
    if len(started) == 1:
        yield from started[0][1]
        return
    waiting: list[tuple[Rank | tuple[float], int, Plan | None]] = [
        ((bound,), number, None) for number, (bound, _) in enumerate(started)
    ]
    heapq.heapify(waiting)
    while waiting:
        _, number, plan = waiting[0]
        if plan is not None:
            yield plan
        following = next(started[number][1], None)
        if following is None:
            heapq.heappop(waiting)
        else:
            heapq.heapreplace(waiting, (following.rank, number, following))
