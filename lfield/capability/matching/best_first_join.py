"""Lazy best-first join: combinations of parts in the order of their cost.

Parts are chosen one after the other. A partial combination waits in a heap with a lower bound of its cost:
the cost of the chosen parts plus the cheapest remaining candidate of each other part. A part that must share
a value with one chosen before is found by a hash join; candidates without a counterpart are removed at the
start. So only inequalities, sums and distances cause unsuccessful attempts.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import count

from msgspec import Struct

from lfield.capability.matching.condition_evaluator import Judge
from lfield.capability.matching.plan import Plan
from lfield.capability.matching.pushdown import Join, PartCheck
from lfield.capability.model import Value


class PlanStream:
    """Plans that are created on first use and cached; the best first."""

    def __init__(self, plans: Iterable[Plan]) -> None:
        self._remaining = iter(plans)
        self._computed: list[Plan] = []

    def at(self, index: int) -> Plan | None:
        """The plan with that number, or None after the last one."""
        while len(self._computed) <= index:
            plan = next(self._remaining, None)
            if plan is None:
                return None
            self._computed.append(plan)
        return self._computed[index]

    def all_of(self, first: int, count: int) -> list[Plan]:
        """A slice of the plans made so far."""
        return self._computed[first : first + count]

    def all(self) -> list[Plan]:
        """All plans."""
        self._computed.extend(self._remaining)
        return self._computed


class SearchBudget(Struct):
    """Remaining effort of a search: failed combinations, and steps; `parent` is charged with it."""

    failures: int
    steps: int
    parent: SearchBudget | None = None

    def spend(self) -> bool:
        """Count one more step; False when the budget is exceeded."""
        self.steps -= 1
        return self.steps >= 0 and (self.parent is None or self.parent.spend())

    def fail(self) -> bool:
        """Count one more failed combination; False when the budget is exceeded."""
        self.failures -= 1
        return self.failures >= 0 and (self.parent is None or self.parent.fail())


class SearchBudgetExceeded(Exception):
    """The search ended before all combinations were tried."""


#: A partial combination: lower bound of its cost, numbers of its parts (-1: not chosen yet), insertion order;
#: its plans in the order of choice, the source of the last one, and its number there.
_PartialChoice = tuple[float, tuple[int, ...], int, tuple[Plan, ...], Sequence[int] | None, int]


class BestFirstJoin:
    """All combinations of some parts that fit, the cheapest first; of equal cost that with the better parts.

    The parts that are `distinct` have no agent in common. Raises SearchBudgetExceeded when `effort` is spent.
    """

    def __init__(
        self,
        parts: Sequence[PlanStream],
        cost: Callable[[Iterable[float]], float],
        effort: SearchBudget,
        joins: Sequence[Join] = (),
        checks: Sequence[PartCheck] = (),
        distinct: frozenset[int] = frozenset(),
    ) -> None:
        self._cost, self._budget, self._joins, self._distinct = cost, effort, joins, distinct
        self._parts = list(parts)
        self._waiting: list[_PartialChoice] = []
        self._numbers = count()
        if joins:
            self._reduce()
        self._cheapest = [part.at(0) for part in self._parts]
        self._order = self._in_order() if all(self._cheapest) else []
        self._checks = [self._due(checks, level) for level in range(len(self._order))]
        self._lookups = [self._lookup(level) for level in range(len(self._order))]

    def __iter__(self) -> Iterator[tuple[Plan, ...]]:
        if not self._order:
            return
        self._choose_next((-1,) * len(self._parts), (), None, 0)
        waiting = self._waiting
        while waiting:
            if not self._budget.spend():
                raise SearchBudgetExceeded
            _, numbers, _, chosen, source, index = heapq.heappop(waiting)
            level = len(chosen) - 1
            self._choose_next(_without(numbers, self._order[level]), chosen[:-1], source, index + 1)
            if not self._fits(chosen):
                if not self._budget.fail():
                    raise SearchBudgetExceeded
            elif len(chosen) == len(self._order):
                yield self._in_needs(chosen)
            else:
                self._choose_next(numbers, chosen, self._candidates(chosen), 0)

    # --- choosing -------------------------------------------------------------------------------------

    def _choose_next(
        self, numbers: tuple[int, ...], chosen: tuple[Plan, ...], source: Sequence[int] | None, index: int
    ) -> None:
        """Choose the next part: that with this index in the source (None: any), where there is one."""
        part = self._order[len(chosen)]
        if source is not None:
            if index >= len(source):
                return
            number = source[index]
        else:
            number = index
        plan = self._parts[part].at(number)
        if plan is None:
            return
        numbers = (*numbers[:part], number, *numbers[part + 1 :])
        chosen = (*chosen, plan)
        entry = (self._bound(numbers, chosen), numbers, next(self._numbers), chosen, source, index)
        heapq.heappush(self._waiting, entry)

    def _bound(self, numbers: Sequence[int], chosen: Sequence[Plan]) -> float:
        """The least cost of a combination that begins with these parts."""
        costs = [0.0 if plan is None else plan.cost for plan in self._cheapest]
        for part, plan in zip(self._order, chosen, strict=False):
            costs[part] = plan.cost
        if self._distinct and len(chosen) < len(self._order):
            self._spread(numbers, costs)
        return self._cost(costs)

    def _spread(self, numbers: Sequence[int], costs: list[float]) -> None:
        """Parts that are distinct and of the same kind cannot all be the cheapest one."""
        used: dict[int, set[int]] = {}
        for part in self._distinct:
            if numbers[part] >= 0:
                used.setdefault(id(self._parts[part]), set()).add(numbers[part])
        for part in sorted(self._distinct):
            if numbers[part] < 0:
                used_numbers = used.setdefault(id(self._parts[part]), set())
                number = next(n for n in count() if n not in used_numbers)
                used_numbers.add(number)
                if (plan := self._parts[part].at(number)) is not None:
                    costs[part] = plan.cost

    def _fits(self, chosen: Sequence[Plan]) -> bool:
        """Whether the part that was chosen last fits to those before it."""
        level = len(chosen) - 1
        part, plan = self._order[level], chosen[level]
        if part in self._distinct:
            agents = plan.agents
            for other, before in zip(self._order, chosen[:-1], strict=False):
                if other in self._distinct and not agents.isdisjoint(before.agents):
                    return False
        for judge, read_facts in self._checks[level]:
            facts = {
                name: value
                for name, place, attribute in read_facts
                if (value := chosen[place].values.get(attribute)) is not None
            }
            if judge(facts) is not True:
                return False
        return True

    def _in_needs(self, chosen: Sequence[Plan]) -> tuple[Plan, ...]:
        by_part = dict(zip(self._order, chosen, strict=True))
        return tuple(by_part[part] for part in range(len(chosen)))

    def _in_order(self) -> list[int]:
        """The parts as they are chosen: those that are joined to one another follow each other."""
        remaining = list(range(len(self._parts)))
        found: list[int] = []
        while remaining:
            tied = [part for part in remaining if any(_ties(join, part, found) for join in self._joins)]
            part = (tied or remaining)[0]
            remaining.remove(part)
            found.append(part)
        return found

    def _due(self, checks: Sequence[PartCheck], level: int) -> list[tuple[Judge, list[tuple[str, int, str]]]]:
        """The checks whose last part is chosen on this level, with the levels of their parts."""
        level_of = {part: number for number, part in enumerate(self._order)}
        return [
            (check.judge, [(name, level_of[part], attribute) for name, part, attribute in check.inputs])
            for check in checks
            if max((level_of[part] for part in check.parts), default=0) == level
        ]

    # --- joins ----------------------------------------------------------------------------------------

    def _lookup(self, level: int) -> list[tuple[int, Judge, dict[Value, list[int]]]]:
        """The joins of the part of a level to earlier parts: the level of that, its value, and an index."""
        part, before = self._order[level], self._order[:level]
        found = []
        for join in self._joins:
            if _ties(join, part, before):
                is_left = join.left == part
                own, judge = (
                    (join.left_value, join.right_value) if is_left else (join.right_value, join.left_value)
                )
                other = join.right if is_left else join.left
                found.append((before.index(other), judge, _index(self._parts[part].all(), own)))
        return found

    def _candidates(self, chosen: Sequence[Plan]) -> Sequence[int] | None:
        """The numbers of the plans for the next part that have values in common with those chosen."""
        candidates: set[int] | None = None
        for level, judge, index in self._lookups[len(chosen)]:
            found = {
                number for value in _members(judge(chosen[level].values)) for number in index.get(value, ())
            }
            candidates = found if candidates is None else candidates & found
        return None if candidates is None else sorted(candidates)

    def _reduce(self) -> None:
        """Remove joined parts without a counterpart, until no more can be removed."""
        changed = True
        while changed:
            changed = False
            for join in self._joins:
                for part, own, other, value in (
                    (join.left, join.left_value, join.right, join.right_value),
                    (join.right, join.right_value, join.left, join.left_value),
                ):
                    values = {v for plan in self._parts[other].all() for v in _members(value(plan.values))}
                    plans = self._parts[part].all()
                    joinable = [plan for plan in plans if not values.isdisjoint(_members(own(plan.values)))]
                    if len(joinable) < len(plans):
                        self._parts[part] = PlanStream(joinable)
                        changed = True


def _without(numbers: tuple[int, ...], part: int) -> tuple[int, ...]:
    return (*numbers[:part], -1, *numbers[part + 1 :])


def _ties(join: Join, part: int, others: Sequence[int]) -> bool:
    return (join.left == part and join.right in others) or (join.right == part and join.left in others)


def _index(plans: Iterable[Plan], value: Judge) -> dict[Value, list[int]]:
    found: dict[Value, list[int]] = {}
    for number, plan in enumerate(plans):
        for member in _members(value(plan.values)):
            found.setdefault(member, []).append(number)
    return found


def _members(value: Value | None) -> Iterable[Value]:
    """The values that equal values have in common: the value, or the members of a set; none if unknown."""
    if value is None:
        return ()
    return value if isinstance(value, frozenset) else (value,)


def teams(
    members: PlanStream, size: int, cost: Callable[[Iterable[float]], float], effort: SearchBudget
) -> Iterator[tuple[Plan, ...]]:
    """All teams of `size` members without a common agent, cheapest first, each once.

    Ties are ordered by the first member, then the second. Raises SearchBudgetExceeded.
    """
    waiting: list[tuple[float, tuple[int, ...], tuple[Plan, ...]]] = []

    def push_team(numbers: tuple[int, ...], chosen: tuple[Plan, ...]) -> None:
        first, missing = numbers[-1], size - len(chosen)
        if members.at(first + missing - 1) is not None:
            following = members.all_of(first, missing)
            bound = cost([plan.cost for plan in (*chosen, *following)])
            heapq.heappush(waiting, (bound, numbers, (*chosen, following[0])))

    push_team((0,), ())
    while waiting:
        if not effort.spend():
            raise SearchBudgetExceeded
        _, numbers, chosen = heapq.heappop(waiting)
        push_team((*numbers[:-1], numbers[-1] + 1), chosen[:-1])
        agents = chosen[-1].agents
        if any(not agents.isdisjoint(other.agents) for other in chosen[:-1]):
            if not effort.fail():
                raise SearchBudgetExceeded
        elif len(chosen) == size:
            yield chosen
        else:
            push_team((*numbers, numbers[-1] + 1), chosen)
