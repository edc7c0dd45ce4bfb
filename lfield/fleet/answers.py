"""What a host answers to `findC` and `explainC`, as plain values that the machine puts into a block."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import lru_cache

from lfield.capability.explain import render
from lfield.capability.expression import Expression, compile_constraint
from lfield.capability.matching import Matcher
from lfield.capability.model import Registry, Value
from lfield.capability.offer import Offer, Team
from lfield.vm.offers import Found

#: How many conditions are kept compiled.
MOST_CONSTRAINTS = 256


class Answers:
    """The capabilities of a `team`, by the ways that the program was built with.

    `numbers` are those of the agents in the deployment.
    """

    def __init__(
        self,
        registry: Registry,
        team: Team,
        ways: Mapping[str, Collection[str]],
        numbers: Mapping[str, int],
    ) -> None:
        self._attributes, self._numbers = registry.attributes, numbers
        self._matcher = Matcher(registry, team, ways)
        self._compiled = lru_cache(MOST_CONSTRAINTS)(self._compile)

    def offers(self, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability and fulfils the condition, best first. Raises ConstraintError."""
        offers = self._matcher.offers(capability, self._compiled(constraint))
        return [found(offer, self._numbers) for offer in offers]

    def explain(self, capability: str, constraint: str | None) -> str:
        """Why everybody else does not, a line each; '' when there is nobody else. Raises ConstraintError."""
        wanted = self._compiled(constraint)
        refusals = self._matcher.explain(capability, wanted)
        if refusals or self._matcher.offers(capability, wanted):
            return render(refusals)
        return f"no agent of this program serves {capability}, alone or with others"

    def _compile(self, constraint: str | None) -> Expression | None:
        return None if constraint is None else compile_constraint(constraint, self._attributes)


def found(offer: Offer, numbers: Mapping[str, int]) -> Found:
    """What L gets to know of an offer."""
    facts = offer.facts
    values = [fact.value for fact in facts.values()]
    return Found(
        offer.way,
        offer.agent,
        offer.host,
        way_text(offer),
        offer.score,
        numbers[offer.agent] if offer.kind == "direct" else -1,
        {name: found(part, numbers) for name, part in offer.parts.items()},
        tuple(facts),
        tuple(map(_number, values)),
        tuple(map(_text, values)),
        tuple([fact.age for fact in facts.values()]),
    )


def way_text(offer: Offer) -> str:
    """How it is served, in words.

    `direct`; `equivalent: climb-lifts of Climb`; `composed: grip-and-climb of Grip (hand), Climb (sky)`.
    How a part is served itself is told in the same way, unless it is directly.
    """
    if offer.kind == "direct":
        return offer.kind
    whole = offer.kind == "composed"
    said = (f"{part.primitive}{_aside(part, whole)}" for part in offer.parts.values())
    return f"{offer.kind}: {offer.rule} of {', '.join(said)}"


def _aside(part: Offer, whole: bool) -> str:
    """Of a part of a whole, who it is; of any part, how it is served."""
    told = [part.agent] if whole else []
    if part.kind != "direct":
        told.append(way_text(part))
    return f" ({', '.join(told)})" if told else ""


def _number(value: Value) -> float:
    """The number of a value; a truth is 1 or 0, and what is no number is NaN."""
    return math.nan if isinstance(value, str | frozenset) else float(value)


def _text(value: Value) -> str | None:
    """The value in words; None for a number, which says it best itself."""
    match value:
        case bool():
            return "true" if value else "false"
        case frozenset():
            return ", ".join(sorted(value))
        case str():
            return value
        case _:
            return None
