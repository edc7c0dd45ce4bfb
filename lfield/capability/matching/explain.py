"""Why somebody is not offered: every agent and every rule that could serve a primitive, with all reasons.

arm2: payload 1.2 < 2.0
rover1: unreachable for 12 s
grip-and-climb: no Grip
  copter1: tools is sling, not gripper
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice

from lfield.capability.matching.assembly import Assembly
from lfield.capability.matching.evaluate import conjuncts
from lfield.capability.matching.plan import Plan
from lfield.capability.matching.provided import Provided
from lfield.capability.matching.reasons import reasons
from lfield.capability.matching.rules import Chain
from lfield.capability.matching.search import Search
from lfield.capability.model import Equivalence, Expression
from lfield.capability.offer import Refusal

#: Combinations of parts that do not fit, of which an explanation tells why.
SHOWN = 16

#: What is said of a rule of which not everything was tried.
TOO_MANY = "there are more combinations of parts than could be tried"

#: So often an explanation goes into what a rule asks for.
MAX_TOLD = 100


def only_best(number: int) -> str:
    """What is said of a rule of which there are more combinations than are offered."""
    return f"only the best {number} combinations are offered"


def nobody_serves(primitive: str) -> str:
    """What is said where nobody is offered, and nobody is there who could be."""
    return f"no agent of this program serves {primitive}, alone or with others"


def render(refusals: Iterable[Refusal], indent: str = "") -> str:
    """A line for each refusal, with those inside it indented below."""
    return "\n".join(_lines(refusals, indent))


def _lines(refusals: Iterable[Refusal], indent: str) -> Iterator[str]:
    for refusal in refusals:
        yield f"{indent}{refusal}"
        yield from _lines(refusal.inner, f"{indent}  ")


@dataclass(frozen=True, slots=True)
class _Place:
    """Where an explanation is: at the end of a chain to a primitive, which is wanted on conditions.

    `depth` is how many rules may stand above the agents of `primitive`; `used` are the compositions above.
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
        """How many rules may still follow."""
        return self.depth - len(self.chain)

    @property
    def asked(self) -> tuple[Expression, ...]:
        """Everything that must be true of who stands at the end."""
        whens = (rule.when for rule in self.chain if rule.when is not None)
        return (*whens, *self.conditions)


class Explanation:
    """Explains the answer of one search."""

    def __init__(self, search: Search) -> None:
        self._search, self._rules = search, search.rules
        #: Of primitives with what was asked of them, whether there was anything to tell.
        self._told: dict[tuple[str, frozenset[Expression]], bool] = {}

    def refusals(self) -> list[Refusal]:
        """Everyone who could do what is searched for and is not offered.

        What was told once is not repeated, and an explanation that nobody would read to its end is cut short.
        """
        search = self._search
        conditions = () if search.constraint is None else (search.constraint,)
        return list(self._at(_Place(search.primitive, conditions, search.limits.depth)))

    def _at(self, place: _Place) -> Iterator[Refusal]:
        for provided in self._rules.providers(place.end):
            yield from self._agents(provided, place)
        for rule in self._rules.equivalences(place.end, place.chain):
            yield from self._equivalence(rule, place)
        for assembly in self._rules.compositions(place.end):
            yield from self._composition(assembly, place)

    def _inside(self, place: _Place) -> tuple[Refusal, ...]:
        """The refusals of what a rule asks for."""
        asked = (place.end, frozenset(place.asked))
        if asked in self._told:
            return (Refusal(place.end, ("as above",)),) if self._told[asked] else ()
        if len(self._told) == MAX_TOLD:
            return (Refusal(place.end, ("more could be said",)),)
        self._told[asked] = True
        inner = tuple(self._at(place))
        self._told[asked] = bool(inner)
        return inner

    def _agents(self, provided: Provided, place: _Place) -> Iterator[Refusal]:
        asked = self._search.asked
        for candidate in self._search.candidates(provided.type):
            found = provided.refusal(candidate, asked)
            found = found or _unfulfilled(provided.plan(candidate, asked), place.asked)
            if found:
                yield Refusal(candidate.agent, found)

    def _equivalence(self, rule: Equivalence, place: _Place) -> Iterator[Refusal]:
        if place.left == 0:
            yield self._too_deep(rule.name)
            return
        below = replace(place, chain=(*place.chain, rule))
        inner = self._inside(below)
        wishes = _taken_apart(place.conditions)
        offered = self._search.serves(place.primitive, below.chain, place.depth, place.used, wishes)
        if not offered:
            yield Refusal(rule.name, (f"no {rule.by}",), inner)
        elif inner:
            yield Refusal(rule.name, (f"not with every {rule.by}",), inner)

    def _composition(self, assembly: Assembly, place: _Place) -> Iterator[Refusal]:
        rule, search = assembly.rule, self._search
        if place.left == 0:
            yield self._too_deep(rule.name)
            return
        if rule.name in place.used:
            yield Refusal(rule.name, ("it would be a part of itself",))
            return
        plans = search.composed(assembly, place.left - 1, place.used, _taken_apart(place.asked))
        if plans.at(0) is not None:
            return
        lacking = tuple(self._lacking(assembly, place))
        if lacking:
            parts = tuple(dict.fromkeys(f"no {below.primitive}" for below in lacking))
            inner = tuple(refusal for below in lacking for refusal in self._inside(below))
            yield Refusal(rule.name, parts, inner)
        else:
            cut = (TOO_MANY,) if rule.name in search.cut else ()
            yield Refusal(rule.name, ("no parts that fit", *cut), tuple(self._misfits(assembly, place)))

    def _lacking(self, assembly: Assembly, place: _Place) -> Iterator[_Place]:
        """The needs for which there is nobody at all."""
        rule = assembly.rule
        for need in rule.needs.values():
            if self._search.need(assembly, need, place.left - 1, place.used).at(0) is None:
                conditions = () if need.when is None else (need.when,)
                yield _Place(need.primitive, conditions, place.left - 1, place.used | {rule.name})

    def _misfits(self, assembly: Assembly, place: _Place) -> Iterator[Refusal]:
        """The cheapest combinations of parts, and why they are not offered."""
        combinations = self._search.combinations(assembly, place.left - 1, place.used)
        for parts in islice(combinations, SHOWN):
            found = assembly.misfits(parts) or _unfulfilled(assembly.plan(parts), place.asked)
            yield Refusal("+".join(part.offer.agent for part in parts), found)

    def _too_deep(self, rule: str) -> Refusal:
        depth = self._search.limits.depth
        return Refusal(rule, (f"at most {depth} rules stand on top of one another",))


def _taken_apart(conditions: Sequence[Expression]) -> tuple[Expression, ...]:
    return tuple(conjunct for condition in conditions for conjunct in conjuncts(condition))


def _unfulfilled(plan: Plan, conditions: Sequence[Expression]) -> tuple[str, ...]:
    """Why a plan does not fulfil conditions; () when it does."""
    values, why, source = plan.values, plan.why, plan.source
    found = (reason for condition in conditions for reason in reasons(condition, values, why, source))
    return tuple(dict.fromkeys(found))
