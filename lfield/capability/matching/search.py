"""The cheapest plans first, made one by one as they are asked for.

Plans form an AND/OR graph: a primitive is served by this or that way, a composition by all of its parts.
Every node is a lazy stream of plans in the order of their costs. A primitive merges those of its ways by a
heap in which a way waits with the least it can cost, so that hopeless ones are never begun; a composition
tries combinations of its parts by their sum, beginning with the cheapest of each. Nodes are shared: each
is made once for a primitive and the number of rules that may still stand on top of one another.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain as joined
from operator import attrgetter

from lfield.capability.matching.assembly import Assembly
from lfield.capability.matching.evaluate import Judge, conjuncts, evaluator, names
from lfield.capability.matching.plan import Plan, fulfilling, standing_in
from lfield.capability.matching.rules import Chain, Rules, least_costs
from lfield.capability.model import Expression, Need
from lfield.capability.offer import Candidate, Team


@dataclass(frozen=True, slots=True)
class Limits:
    """What a search does at most.

    depth           rules on top of one another
    per_rule        offers of each composition
    combinations    combinations of parts that are tried for one composition
    tried           combinations that are tried in all
    offers          offers that are given, the best of all
    """

    depth: int = 4
    per_rule: int = 16
    combinations: int = 1_000
    tried: int = 2_000
    offers: int = 32


class Stream:
    """Plans that are made when they are first asked for, and kept."""

    def __init__(self, plans: Iterable[Plan]) -> None:
        self._rest = iter(plans)
        self._made: list[Plan] = []

    def at(self, index: int) -> Plan | None:
        """The plan with that number, or None behind the last one."""
        while len(self._made) <= index:
            plan = next(self._rest, None)
            if plan is None:
                return None
            self._made.append(plan)
        return self._made[index]

    def __iter__(self) -> Iterator[Plan]:
        index = 0
        while (plan := self.at(index)) is not None:
            yield plan
            index += 1


@dataclass(frozen=True, slots=True)
class _Way:
    """A chain of one-to-one rules, at its end agents or a composition; it costs at least `bound`."""

    chain: Chain
    assembly: Assembly | None
    bound: float


class Search:
    """One query for a primitive, on what the team is now."""

    def __init__(
        self, rules: Rules, team: Team, limits: Limits, primitive: str, constraint: Expression | None
    ) -> None:
        self.rules, self.limits = rules, limits
        self.primitive, self.constraint = primitive, constraint
        #: The attributes in the constraint.
        self.named = named(constraint)
        #: Compositions of which not all combinations were tried.
        self.cut: set[str] = set()
        self._team = team
        self._tried = 0
        self._candidates: dict[str, Sequence[Candidate]] = {}
        self._agents: dict[str, list[Plan]] = {}
        self._streams: dict[tuple[str, int, frozenset[str]], Stream] = {}
        self._composed: dict[tuple[str, int, frozenset[str]], Stream] = {}
        self._needs: dict[tuple[str, str, int, frozenset[str]], Stream] = {}
        self._least = least_costs(rules, primitive, self._cheapest)

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type, asked for once."""
        if resource not in self._candidates:
            self._candidates[resource] = self._team.candidates(resource)
        return self._candidates[resource]

    def agents(self, primitive: str) -> list[Plan]:
        """The agents that serve a primitive themselves, the cheapest first."""
        if primitive not in self._agents:
            found = [
                provided.plans(self.candidates(provided.type), self.named)
                for provided in self.rules.providers(primitive)
            ]
            self._agents[primitive] = sorted(joined(*found), key=attrgetter("cost"))
        return self._agents[primitive]

    def plans(self) -> Iterator[Plan]:
        """All plans that fulfil the constraint, the cheapest first; of each composition the best."""
        given: Counter[str] = Counter()
        found, wished = [], judges(self.constraint)
        for way in self._ways(self.primitive, self.limits.depth, frozenset()):
            plans = self._plans(way, self.primitive, self.limits.depth, frozenset(), wished)
            if way.assembly is not None:
                plans = self._not_full(plans, way.assembly, given)
            found.append((way.bound, plans))
        for plan in _merged(found):
            if not plan.composition:
                yield plan
            elif given[plan.composition] < self.limits.per_rule:
                given[plan.composition] += 1
                yield plan

    def _not_full(self, plans: Iterator[Plan], assembly: Assembly, given: Counter[str]) -> Iterator[Plan]:
        """The plans, until enough of the composition were given, here or by other chains."""
        while given[assembly.rule.name] < self.limits.per_rule:
            plan = next(plans, None)
            if plan is None:
                return
            yield plan

    def serves(
        self, primitive: str, chain: Chain, depth: int, used: frozenset[str], wished: Sequence[Judge]
    ) -> bool:
        """Whether there is any plan by a chain that begins with this one."""
        found = (way for way in self._ways(primitive, depth, used) if way.chain[: len(chain)] == chain)
        plans = (self._plans(way, primitive, depth, used, wished) for way in found)
        return next(joined.from_iterable(plans), None) is not None

    def stream(self, primitive: str, depth: int, used: frozenset[str]) -> Stream:
        """All plans for a primitive; `used` are the compositions that it is part of already."""
        # What cannot occur below makes no difference: without it the node is shared.
        used &= self.rules.inside(primitive)
        node = (primitive, depth, used)
        if node not in self._streams:
            found = self._ways(primitive, depth, used)
            plans = _merged([(way.bound, self._plans(way, primitive, depth, used, ())) for way in found])
            self._streams[node] = Stream(plans)
        return self._streams[node]

    def composed(self, assembly: Assembly, depth: int, used: frozenset[str]) -> Stream:
        """The combinations of parts that fit, with so many rules below the composition's own."""
        used &= self.rules.inside(assembly.rule.serves)
        node = (assembly.rule.name, depth, used)
        if node not in self._composed:
            self._composed[node] = Stream(self._fitting(assembly, depth, used))
        return self._composed[node]

    def need(self, assembly: Assembly, need: Need, depth: int, used: frozenset[str]) -> Stream:
        """The plans for one part of a composition."""
        used |= {assembly.rule.name}
        if need.when is None:
            return self.stream(need.primitive, depth, used)
        node = (assembly.rule.name, need.name, depth, used & self.rules.inside(need.primitive))
        if node not in self._needs:
            plans = fulfilling(self.stream(need.primitive, depth, used), judges(need.when))
            self._needs[node] = Stream(plans)
        return self._needs[node]

    def combinations(
        self, assembly: Assembly, depth: int, used: frozenset[str]
    ) -> Iterator[tuple[Plan, ...]]:
        """Every choice of parts, the cheapest first, whether they fit together or not."""
        streams = [self.need(assembly, need, depth, used) for need in assembly.rule.needs.values()]
        numbers, raised = (0,) * len(streams), 0
        first = _chosen(streams, numbers)
        waiting = [] if first is None else [(assembly.cost(first), numbers, raised, first)]
        while waiting:
            _, numbers, raised, parts = heapq.heappop(waiting)
            yield parts
            # Each choice is reached from one other, in which its last raised number is one less.
            for place in range(raised, len(streams)):
                following = (*numbers[:place], numbers[place] + 1, *numbers[place + 1 :])
                if (choice := _chosen(streams, following)) is not None:
                    heapq.heappush(waiting, (assembly.cost(choice), following, place, choice))

    def _cheapest(self, primitive: str) -> float | None:
        found = self.agents(primitive)
        return found[0].cost if found else None

    def _fitting(self, assembly: Assembly, depth: int, used: frozenset[str]) -> Iterator[Plan]:
        for tried, parts in enumerate(self.combinations(assembly, depth, used)):
            if tried == self.limits.combinations or self._tried >= self.limits.tried:
                self.cut.add(assembly.rule.name)
                return
            self._tried += 1
            if (plan := assembly.plan(parts)) is not None:
                yield plan

    def _ways(self, primitive: str, depth: int, used: frozenset[str]) -> Iterator[_Way]:
        """All ways to a primitive, in the order in which they win ties."""
        for chain in self.rules.chains(primitive):
            if len(chain) > depth:
                return
            end = _end(chain, primitive)
            if own := self.agents(end):
                yield _Way(chain, None, self._by_chain(chain, own[0].cost))
            for assembly in self.rules.compositions(end) if len(chain) < depth else ():
                least = assembly.least(self._least)
                if least is not None and assembly.rule.name not in used:
                    yield _Way(chain, assembly, self._by_chain(chain, least))

    def _by_chain(self, chain: Chain, cost: float) -> float:
        """What an offer by a chain costs, from the cost at its end."""
        for rule in reversed(chain):
            cost = self.rules.ranking.by_rule(cost, rule.loss)
        return cost

    def _plans(
        self, way: _Way, primitive: str, depth: int, used: frozenset[str], wished: Sequence[Judge]
    ) -> Iterator[Plan]:
        """The plans of one way that fulfil what its rules ask and what is wished."""
        behind: Iterable[Plan]
        if way.assembly is None:
            behind = self.agents(_end(way.chain, primitive))
        else:
            behind = self.composed(way.assembly, depth - len(way.chain) - 1, used)
        asked = [judge for rule in way.chain for judge in judges(rule.when)]
        for plan in fulfilling(behind, [*asked, *wished]):
            for rule in reversed(way.chain):
                plan = standing_in(rule, plan, self.rules.ranking)
            yield plan


def judges(condition: Expression | None) -> list[Judge]:
    """One function for each conjunct of a condition."""
    return [] if condition is None else [evaluator(conjunct) for conjunct in conjuncts(condition)]


def named(condition: Expression | None) -> frozenset[str]:
    """The attributes that a condition looks at."""
    return frozenset() if condition is None else frozenset(names(condition))


def _end(chain: Chain, primitive: str) -> str:
    """The primitive at the end of a chain."""
    return chain[-1].by if chain else primitive


def _chosen(streams: Sequence[Stream], numbers: Sequence[int]) -> tuple[Plan, ...] | None:
    """The plans with these numbers, or None when one of the streams is not as long."""
    found = [stream.at(number) for stream, number in zip(streams, numbers, strict=True)]
    plans = tuple(plan for plan in found if plan is not None)
    return plans if len(plans) == len(streams) else None


def _merged(streams: Iterable[tuple[float, Iterator[Plan]]]) -> Iterator[Plan]:
    """The plans of ordered streams in the order of their costs; of equal ones the earlier stream's first.

    A stream that is not begun waits with the least that its plans can cost.
    """
    started = list(streams)
    waiting: list[tuple[float, int, Plan | None]] = [
        (bound, rank, None) for rank, (bound, _) in enumerate(started)
    ]
    heapq.heapify(waiting)
    while waiting:
        _, rank, plan = waiting[0]
        if plan is not None:
            yield plan
        following = next(started[rank][1], None)
        if following is None:
            heapq.heappop(waiting)
        else:
            heapq.heapreplace(waiting, (following.cost, rank, following))
