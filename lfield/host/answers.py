"""What a host answers to `findC` and `explainC`, as plain values that the machine puts into a block."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import lru_cache
from typing import Any, TypeVar

from lfield.capability.matching.explain import render
from lfield.capability.matching.expression import compile_constraint
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Expression, Registry
from lfield.capability.offer import Offer, Team
from lfield.vm.offers import Found

#: How many conditions are kept compiled.
MOST_CONSTRAINTS = 256

T = TypeVar("T")

_NO_PARTS: Mapping[str, Found] = {}


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
        self._last: dict[int, tuple[Offer, Found]] = {}
        self._compiled = lru_cache(MOST_CONSTRAINTS)(self._compile)

    def offers(self, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability and fulfils the condition, best first. Raises ConstraintError."""
        before, self._last = self._last, {}
        for offer in self._matcher.offers(capability, self._compiled(constraint)):
            # Where nothing has changed, the matcher gives the very same offers again.
            key = id(offer)
            self._last[key] = before.get(key) or (offer, found(offer, self._numbers))
        return [one for _, one in self._last.values()]

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
    """What L gets to know of an offer. There may be a thousand of them in one answer."""
    facts = offer.facts.values()
    values: list[Any] = [fact.value for fact in facts]
    texts: list[str | None] = [None] * len(values)
    for i in _worded(tuple(map(type, values))):
        texts[i] = _text(values[i])
        values[i] = float(values[i]) if isinstance(values[i], bool) else math.nan
    direct = offer.kind == "direct"
    return Found(
        offer.way,
        offer.agent,
        offer.host,
        offer.kind if direct else way_text(offer),
        offer.score,
        numbers[offer.agent] if direct else -1,
        {name: found(part, numbers) for name, part in offer.parts.items()} if offer.parts else _NO_PARTS,
        _same(tuple(offer.facts)),
        tuple(values),
        _same(tuple(texts)),
        _same(tuple([fact.age for fact in facts])),
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


@lru_cache(maxsize=1024)
def _same(values: tuple[T, ...]) -> tuple[T, ...]:
    """One tuple for all that are equal: the machine writes it once, and sees at a glance that it has."""
    return values


@lru_cache(maxsize=1024)
def _worded(types: tuple[type, ...]) -> tuple[int, ...]:
    """Which values of these types have words of their own: all but numbers."""
    return tuple(i for i, kind in enumerate(types) if kind not in (int, float))


@lru_cache(maxsize=1024)
def _text(value: bool | str | frozenset[str]) -> str:
    """The value in words."""
    if isinstance(value, frozenset):
        return ", ".join(sorted(value))
    return value if isinstance(value, str) else str(value).lower()
