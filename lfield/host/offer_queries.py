"""Capability queries of a host: the answers to `findC` and `explainC`, from its directory, without messages.

The answers are plain values, which the machine copies into a block.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import lru_cache

from lfield.capability.matching.explanation import no_provider_note, render_refusals
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import ANY_OFFER, OfferQuery, Registry, Value
from lfield.capability.offer import AgentSource, Fact, Offer
from lfield.capability.query_values import SEPARATOR, bind, split_values
from lfield.errors import ConstraintError
from lfield.host.team_directory import TeamDirectory
from lfield.mission.mission import Mission
from lfield.vm.offer_objects import FoundOffer, SearchIncomplete, realisations

#: The number of compiled conditions in the cache.
MAX_CACHED_CONSTRAINTS = 256


class CapabilityQueries:
    """The capability queries of a mission's team, for the capabilities compiled into its program."""

    def __init__(self, directory: TeamDirectory, mission: Mission) -> None:
        numbers, usable = mission.team.member_numbers, realisations(mission.program)
        self._directory = directory
        self._results = MatchResults(directory.registry, directory.directory, usable, numbers)

    def find_offers(self, caller: str, capability: str, constraint: str | None) -> list[FoundOffer]:
        """The offers of a capability for a coordinator that satisfy the condition, best first.

        Raises ConstraintError, and SearchIncomplete if none was found and the search was cut short.
        """
        self._refresh(caller)
        return self._results.find_offers(capability, constraint)

    def find_teams(
        self, caller: str, capability: str, constraint: str | None, size: int
    ) -> list[list[FoundOffer]]:
        """Teams of this size without common agents, best first. Raises the errors of `find_offers`."""
        self._refresh(caller)
        return self._results.find_teams(capability, constraint, size)

    def explain_others(self, caller: str, capability: str, constraint: str | None) -> str:
        """The reasons why the other agents do not match, a line each. Raises ConstraintError."""
        self._refresh(caller)
        return self._results.explain_others(capability, constraint)

    def _refresh(self, asker: str) -> None:
        self._directory.refresh()
        self._directory.directory.answer_for(asker)


class MatchResults:
    """Matches offers of a `team`, with the realisations compiled into the program.

    `numbers` are the indexes of the agents in the deployment.
    """

    def __init__(
        self,
        registry: Registry,
        team: AgentSource,
        primitives: Mapping[str, Collection[str]],
        numbers: Mapping[str, int],
    ) -> None:
        self._registry, self._numbers = registry, numbers
        self._matcher = Matcher(registry, team, primitives)
        self._compiled = lru_cache(MAX_CACHED_CONSTRAINTS)(self._compile)

    def find_offers(self, capability: str, constraint: str | None) -> list[FoundOffer]:
        """The best offers of a capability that satisfy the condition, best first.

        Raises ConstraintError, and SearchIncomplete if none was found and the search was cut short.
        """
        answer = self._matcher.find(capability, self._compiled(constraint))
        if answer.cut and not answer.offers:
            raise SearchIncomplete(f"no offer was found for {capability}, but {'; '.join(answer.notes)}")
        note = "; ".join(answer.notes)
        return [to_vm_offer(offer, self._numbers, answer.count, note) for offer in answer.offers]

    def find_teams(self, capability: str, constraint: str | None, size: int) -> list[list[FoundOffer]]:
        """Teams of this size without common agents, best first. Raises the errors of `find_offers`."""
        if size < 1:
            raise ConstraintError(f"a team of {size}", ["a team has one member at least"])
        answer = self._matcher.teams(capability, size, self._compiled(constraint))
        note = "; ".join(answer.notes)
        if note and not answer.teams and size <= len(self._numbers):
            raise SearchIncomplete(f"no team of {size} was found for {capability}, but {note}")
        return [
            [to_vm_offer(offer, self._numbers, answer.agents, note) for offer in team]
            for team in answer.teams
        ]

    def explain_others(self, capability: str, constraint: str | None) -> str:
        """The number of offers, and the reasons why the other agents do not match, a line each. Raises
        ConstraintError.
        """
        query = self._compiled(constraint)
        answer = self._matcher.find(capability, query)
        refusals = self._matcher.explain(capability, query.condition)
        if not answer.count and not refusals:
            return no_provider_note(capability)
        agents = self._matcher.agents(capability, query)
        return "\n".join([*answer.summary(agents), *filter(None, [render_refusals(refusals)])])

    def _compile(self, constraint: str | None) -> OfferQuery:
        if constraint is None:
            return ANY_OFFER
        text, values = split_values(constraint)
        compiled = self._registry.constraints.get(text)
        if compiled is None:
            compiled = self._parsed(text)
        return compiled if values is None else bind(compiled, values)

    def _parsed(self, text: str) -> OfferQuery:
        """The query in a text; only a text that the program computes needs the parser of L."""
        from lfield.capability.condition_compiler import compile_query, compile_template

        if text.endswith(SEPARATOR):
            return compile_template(text.removesuffix(SEPARATOR), self._registry.attributes)
        return compile_query(text, self._registry.attributes)


def to_vm_offer(offer: Offer, numbers: Mapping[str, int], count: int = 0, note: str = "") -> FoundOffer:
    """An offer as L sees it; `count` is the number of offers."""
    direct = offer.kind == "direct"
    values = [fact.value for fact in offer.facts.values()]
    return FoundOffer(
        realisation=offer.realisation,
        agent=offer.agent,
        host=offer.host,
        kind=binding_label(offer),
        score=offer.score,
        member=numbers[offer.agent] if direct else -1,
        parts={name: to_vm_offer(part, numbers) for name, part in offer.parts.items()},
        names=tuple(offer.facts),
        numbers=tuple(float(v) if isinstance(v, int | float) else math.nan for v in values),
        texts=tuple(_value_text(value) for value in values),
        ages=tuple(_growing_age(fact) for fact in offer.facts.values()),
        sources=tuple("measured" if fact.of == "measured" else fact.source for fact in offer.facts.values()),
        found=count,
        note=note,
    )


def _growing_age(fact: Fact) -> float:
    """The age of a fact; NaN for a constant fact: only measured values age."""
    return fact.age if fact.of == "measured" or fact.age else math.nan


def _value_text(value: Value) -> str | None:
    """A value in words; None for a number, which L prints itself."""
    match value:
        case bool():
            return str(value).lower()
        case int() | float():
            return None
        case str():
            return value
        case _:
            return ", ".join(sorted(value))


def binding_label(offer: Offer) -> str:
    """A description of the realisation of an offer.

    `direct`; `equivalent: climb-lifts of Climb`; `composed: grip-and-climb of Grip (hand), Climb (sky)`.
    A component that is not realised directly is described in the same form.
    """
    if offer.kind == "direct":
        return offer.kind
    is_composed = offer.kind == "composed"
    parts = (f"{part.primitive}{_component_label(part, is_composed)}" for part in offer.parts.values())
    return f"{offer.kind}: {offer.rule} of {', '.join(parts)}"


def _component_label(part: Offer, parent: bool) -> str:
    """The component's agent if it has a parent, and its realisation."""
    parts = [part.agent] if parent else []
    if part.kind != "direct":
        parts.append(binding_label(part))
    return f" ({', '.join(parts)})" if parts else ""
