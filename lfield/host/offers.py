"""Who offers what: a host's answers to `findC` and `explainC`, from its directory. A question sends nothing.

They are plain values, which the machine puts into a block.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import lru_cache

from lfield.capability.matching.explain import nobody_serves, render
from lfield.capability.matching.expression import compile_wish
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import ANYBODY, Registry, Value, Wish
from lfield.capability.offer import Fact, Offer, Team
from lfield.errors import ConstraintError
from lfield.host.directory import TeamDirectory
from lfield.mission.access.rules import Barred
from lfield.mission.mission import Mission
from lfield.vm.offers import Found, SearchGivenUp, ways

#: How many conditions are kept compiled.
MOST_CONSTRAINTS = 256


class Offers:
    """The capabilities of a mission's team, as far as its program was built with them."""

    def __init__(self, directory: TeamDirectory, mission: Mission) -> None:
        numbers = {member.id: member.number for member in mission.team.members}
        self._directory = directory
        if mission.access.callers:
            directory.directory.barred = Barred(mission.access, mission.team.members, directory.registry)
        self._answers = Answers(directory.registry, directory.directory, ways(mission.program), numbers)

    def offers(self, asker: str, capability: str, constraint: str | None) -> list[Found]:
        """Who offers a capability to a coordinator and fulfils the condition, best first.

        Raises ConstraintError, and SearchGivenUp where nobody was found and not everything could be tried.
        """
        self._look(asker)
        return self._answers.offers(capability, constraint)

    def teams(self, asker: str, capability: str, constraint: str | None, size: int) -> list[list[Found]]:
        """Teams of so many that have no agent in common, best first. Raises what `offers` does."""
        self._look(asker)
        return self._answers.teams(capability, constraint, size)

    def explain(self, asker: str, capability: str, constraint: str | None) -> str:
        """Why everybody else does not, a line each. Raises ConstraintError."""
        self._look(asker)
        return self._answers.explain(capability, constraint)

    def _look(self, asker: str) -> None:
        self._directory.look()
        self._directory.directory.asker = asker


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
        """The best who offer a capability and fulfil the condition, best first.

        Raises ConstraintError, and SearchGivenUp where nobody was found and not everything could be tried.
        """
        answer = self._matcher.find(capability, self._compiled(constraint))
        if answer.cut and not answer.offers:
            raise SearchGivenUp(f"nobody was found for {capability}, but {'; '.join(answer.notes)}")
        note = "; ".join(answer.notes)
        return [found(offer, self._numbers, answer.count, note) for offer in answer.offers]

    def teams(self, capability: str, constraint: str | None, size: int) -> list[list[Found]]:
        """Teams of so many that have no agent in common, best first. Raises what `offers` does."""
        if size < 1:
            raise ConstraintError(f"a team of {size}", ["a team has one member at least"])
        answer = self._matcher.teams(capability, size, self._compiled(constraint))
        note = "; ".join(answer.notes)
        if note and not answer.teams and size <= len(self._numbers):
            raise SearchGivenUp(f"no team of {size} was found for {capability}, but {note}")
        return [[found(offer, self._numbers, answer.agents, note) for offer in team] for team in answer.teams]

    def explain(self, capability: str, constraint: str | None) -> str:
        """How many offers there are, and why everybody else does not, a line each. Raises ConstraintError."""
        wish = self._compiled(constraint)
        answer = self._matcher.find(capability, wish)
        refusals = self._matcher.explain(capability, wish.condition)
        if not answer.count and not refusals:
            return nobody_serves(capability)
        agents = self._matcher.agents(capability, wish)
        return "\n".join([*answer.summary(agents), *filter(None, [render(refusals)])])

    def _compile(self, constraint: str | None) -> Wish:
        return ANYBODY if constraint is None else compile_wish(constraint, self._attributes)


def found(offer: Offer, numbers: Mapping[str, int], count: int = 0, note: str = "") -> Found:
    """What L gets to know of an offer, of which there were so many."""
    direct = offer.kind == "direct"
    values = [fact.value for fact in offer.facts.values()]
    return Found(
        way=offer.way,
        agent=offer.agent,
        host=offer.host,
        kind=way_text(offer),
        score=offer.score,
        member=numbers[offer.agent] if direct else -1,
        parts={name: found(part, numbers) for name, part in offer.parts.items()},
        names=tuple(offer.facts),
        numbers=tuple(float(v) if isinstance(v, int | float) else math.nan for v in values),
        texts=tuple(_text(value) for value in values),
        ages=tuple(_growing(fact) for fact in offer.facts.values()),
        sources=tuple("measured" if fact.of == "measured" else fact.source for fact in offer.facts.values()),
        found=count,
        note=note,
    )


def _growing(fact: Fact) -> float:
    """The age of a fact, NaN when it does not grow: only what is measured anew grows old."""
    return fact.age if fact.of == "measured" or fact.age else math.nan


def _text(value: Value) -> str | None:
    """A value in words; None for a number, which L shows itself."""
    match value:
        case bool():
            return str(value).lower()
        case int() | float():
            return None
        case str():
            return value
        case _:
            return ", ".join(sorted(value))


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
