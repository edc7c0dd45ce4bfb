"""Explains missing offers: every agent and every rule that could serve a primitive, with all reasons.

arm2: payload 1.2 < 2.0
rover1: unreachable for 12 s
grip-and-climb: no Grip
  copter1: tools is sling, not gripper
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice

from msgspec import Struct
from msgspec.structs import replace

from lfield.capability.matching.assembly import Assembly
from lfield.capability.matching.condition_evaluator import conjuncts
from lfield.capability.matching.failure_reasons import failure_reasons
from lfield.capability.matching.plan import Plan
from lfield.capability.matching.plan_search import Search
from lfield.capability.matching.provider_plans import ProviderPlans
from lfield.capability.matching.rule_index import Chain
from lfield.capability.model import Equivalence, Expression
from lfield.capability.offer import Rejection

#: Maximum number of combinations of parts that an explanation examines, and that it shows.
MAX_COMBINATIONS_TRIED, MAX_COMBINATIONS_SHOWN = 64, 16

#: The note for a rule whose search was cut off.
TOO_MANY = "more combinations of parts exist than could be tried"

#: The most levels of rules that an explanation follows.
MAX_REFUSALS = 100


def partial_search_note(number: int) -> str:
    """The note for a rule with more combinations than are offered."""
    return f"only the best {number} combinations are offered"


def no_provider_note(primitive: str) -> str:
    """The note when no agent of the program could be offered."""
    return f"no agent of this program serves {primitive}, alone or with others"


def render_refusals(refusals: Iterable[Rejection], indent: str = "") -> str:
    """A line for each refusal, with those inside it indented below."""
    return "\n".join(_lines(refusals, indent))


def _lines(refusals: Iterable[Rejection], indent: str) -> Iterator[str]:
    for refusal in refusals:
        yield f"{indent}{refusal}"
        yield from _lines(refusal.inner, f"{indent}  ")


class _Node(Struct, frozen=True):
    """A position in an explanation: the end of a chain to a primitive, with conditions.

    `depth` is how many rules may be chained above the agents of `primitive`; `used` are the compositions
    above.
    """

    primitive: str
    conditions: tuple[Expression, ...]
    depth: int
    used: frozenset[str] = frozenset()
    chain: Chain = ()

    @property
    def end(self) -> str:
        """The primitive at the end of the chain."""
        return self.chain[-1].by if self.chain else self.primitive

    @property
    def left(self) -> int:
        """The number of rules that may still follow."""
        return self.depth - len(self.chain)

    @property
    def all_conditions(self) -> tuple[Expression, ...]:
        """All conditions on the agent at the end of the chain."""
        whens = (rule.when for rule in self.chain if rule.when is not None)
        return (*whens, *self.conditions)


class Explanation:
    """Explains the answer of one search."""

    def __init__(self, search: Search) -> None:
        self._search, self._rules = search, search.rules
        #: Whether a primitive with its conditions had anything to report.
        self._reported: dict[tuple[str, frozenset[Expression]], bool] = {}

    def refusals(self) -> list[Rejection]:
        """The possible providers that are not offered, with the reasons.

        Each reason is reported once, and a long explanation is cut.
        """
        search = self._search
        conditions = () if search.constraint is None else (search.constraint,)
        return list(self._at(_Node(search.primitive, conditions, search.limits.depth)))

    def _at(self, place: _Node) -> Iterator[Rejection]:
        for provided in self._rules.providers(place.end):
            yield from self._agents(provided, place)
        for rule in self._rules.equivalences(place.end, place.chain):
            yield from self._equivalence(rule, place)
        for assembly in self._rules.compositions(place.end):
            yield from self._composition(assembly, place)

    def _inside(self, place: _Node) -> tuple[Rejection, ...]:
        """The refusals of the needs of a rule."""
        key = (place.end, frozenset(place.all_conditions))
        if key in self._reported:
            return (Rejection(place.end, ("as above",)),) if self._reported[key] else ()
        if len(self._reported) == MAX_REFUSALS:
            return (Rejection(place.end, ("more reasons exist",)),)
        self._reported[key] = True
        inner = tuple(self._at(place))
        self._reported[key] = bool(inner)
        return inner

    def _agents(self, provided: ProviderPlans, place: _Node) -> Iterator[Rejection]:
        context = self._search.context
        for candidate in self._search.candidates(provided.type):
            found = provided.refusal(candidate, context)
            found = found or _failed_conditions(provided.plan(candidate, context), place.all_conditions)
            if found:
                yield Rejection(candidate.agent, found)

    def _equivalence(self, rule: Equivalence, place: _Node) -> Iterator[Rejection]:
        if place.left == 0:
            yield self._too_deep(rule.name)
            return
        below = replace(place, chain=(*place.chain, rule))
        inner = self._inside(below)
        conditions = _conjuncts(place.conditions)
        offered = self._search.has_plan(place.primitive, below.chain, place.depth, place.used, conditions)
        if not offered:
            yield Rejection(rule.name, (f"no {rule.by}",), inner)
        elif inner:
            yield Rejection(rule.name, (f"not with every {rule.by}",), inner)

    def _composition(self, assembly: Assembly, place: _Node) -> Iterator[Rejection]:
        rule, search = assembly.rule, self._search
        if place.left == 0:
            yield self._too_deep(rule.name)
            return
        if rule.name in place.used:
            yield Rejection(rule.name, ("it would be a part of itself",))
            return
        plans = search.composed(assembly, place.left - 1, place.used, _conjuncts(place.all_conditions))
        if plans.at(0) is not None:
            return
        lacking = tuple(self._unserved_needs(assembly, place))
        if lacking:
            parts = tuple(dict.fromkeys(f"no {below.primitive}" for below in lacking))
            inner = tuple(refusal for below in lacking for refusal in self._inside(below))
            yield Rejection(rule.name, parts, inner)
        else:
            cut = (TOO_MANY,) if rule.name in search.cut else ()
            yield Rejection(
                rule.name,
                ("no suitable combination of parts", *cut),
                tuple(self._conflicting_combinations(assembly, place)),
            )

    def _unserved_needs(self, assembly: Assembly, place: _Node) -> Iterator[_Node]:
        """The needs that no agent serves."""
        rule = assembly.rule
        for need in rule.needs.values():
            if self._search.plans_for_need(assembly, need, place.left - 1, place.used).at(0) is None:
                conditions = () if need.when is None else (need.when,)
                yield _Node(need.primitive, conditions, place.left - 1, place.used | {rule.name})

    def _conflicting_combinations(self, assembly: Assembly, place: _Node) -> Iterator[Rejection]:
        """The cheapest combinations of parts, and the reasons why they are not offered."""
        combinations = self._search.combinations(assembly, place.left - 1, place.used)
        tried = list(islice(combinations, MAX_COMBINATIONS_TRIED))
        # A pair of an agent with itself is left out where other pairs exist.
        distinct = [parts for parts in tried if len({part.offer.agent for part in parts}) == len(parts)]
        for parts in (distinct or tried)[:MAX_COMBINATIONS_SHOWN]:
            found = assembly.conflicts(parts) or _failed_conditions(
                assembly.plan(parts), place.all_conditions
            )
            yield Rejection("+".join(part.offer.agent for part in parts), found)

    def _too_deep(self, rule: str) -> Rejection:
        depth = self._search.limits.depth
        return Rejection(rule, (f"at most {depth} rules are chained",))


def _conjuncts(conditions: Sequence[Expression]) -> tuple[Expression, ...]:
    return tuple(conjunct for condition in conditions for conjunct in conjuncts(condition))


def _failed_conditions(plan: Plan, conditions: Sequence[Expression]) -> tuple[str, ...]:
    """The reasons why a plan does not fulfil conditions; () when it does."""
    values, reason_of, source = plan.values, plan.unknown_reason, plan.source
    found = (
        reason for condition in conditions for reason in failure_reasons(condition, values, reason_of, source)
    )
    return tuple(dict.fromkeys(found))
