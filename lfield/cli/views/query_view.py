"""Answers to a query: as a table with trees below it, and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from lfield.capability.matching.explanation import no_provider_note, render_refusals
from lfield.capability.matching.plan_search import attributes_of
from lfield.capability.model import Registry
from lfield.capability.offer import Fact, Offer
from lfield.cli.views.score_view import score_lines
from lfield.cli.views.trees import plain_console, print_tree
from lfield.client.query_json import KnownTeam, parts_of, unit_of
from lfield.operator.query_parser import CapabilityQuery
from lfield.operator.registry.sheets import printable, value_text
from lfield.operator.registry.taxonomy import TreeBranch
from lfield.operator.team_query import PrimitiveAnswer

if TYPE_CHECKING:
    from rich.table import Table


#: Maximum number of attributes shown of an offer, the most relevant first; `--json` has all.
MAX_FACTS = 6


# --- as text ------------------------------------------------------------------------------------------


def show(
    question: CapabilityQuery,
    known: KnownTeam,
    answers: Sequence[PrimitiveAnswer],
    registry: Registry,
    *,
    explain: bool,
) -> None:
    """Print the answers."""
    print(known)
    for answer in answers:
        print(f"\n{answer.primitive.name} ({answer.primitive.id})")
        if answer.offers:
            _show_offers(answer.offers, _Attributes(registry, question))
        else:
            print(_no_offers_text(answer, explain))
        if answer.teams is not None:
            _show_teams(answer)
        for note in answer.notes:
            print(note)
        if explain and answer.offers:
            print("\nscores:")
            print("\n".join(f"  {printable(line)}" for line in score_lines(answer.offers)))
        if explain and answer.refusals:
            print("\nnot offered:")
            print("\n".join(map(printable, render_refusals(answer.refusals, "  ").splitlines())))


def _no_offers_text(answer: PrimitiveAnswer, explain: bool) -> str:
    if not answer.refusals and not answer.is_truncated:
        return no_provider_note(answer.primitive.name)
    text = "no agent found; not all combinations were tried" if answer.is_truncated else "no agent can"
    return text if explain else f"{text}; --explain prints the reasons"


class _Attributes:
    """The facts of offers as text: first those in the condition, then the ranked ones, then the rest."""

    def __init__(self, registry: Registry, question: CapabilityQuery) -> None:
        self._registry = registry
        self._named = attributes_of(question.constraint)

    def describe(self, facts: Mapping[str, Fact], limit: int = MAX_FACTS) -> str:
        """`nominal: payload 2 kg, speed 3 m/s; measured 3.0 s ago: battery 0.8`, and the number of others."""
        first = sorted(facts, key=lambda name: (name not in self._named, not self._is_rated(name)))
        alike = groupby(first[:limit], key=lambda name: facts[name].source)
        parts = [
            f"{source}: {', '.join(self._describe_fact(n, facts[n]) for n in names)}"
            for source, names in alike
        ]
        parts += [f"and {len(first) - limit} more"] if len(first) > limit else []
        return "; ".join(parts)

    def _is_rated(self, name: str) -> bool:
        attribute = self._registry.attributes.get(name)
        return attribute is not None and attribute.better != "none"

    def _describe_fact(self, name: str, fact: Fact) -> str:
        return f"{name} {value_text(fact.value, unit_of(self._registry, name))}"


def _show_offers(offers: Sequence[Offer], attributes: _Attributes) -> None:
    plain_console().print(_table(offers, attributes))
    composed = [(rank, offer) for rank, offer in enumerate(offers, 1) if _is_composed(offer)]
    if composed:
        print()
        print_tree(_tree(f"{rank}: {how(offer)}", offer, attributes) for rank, offer in composed)


def _show_teams(answer: PrimitiveAnswer) -> None:
    """The teams by their members, whose data are in the table above."""
    agents = f"{answer.agents} agent{'' if answer.agents == 1 else 's'}"
    print("\nteams:" if answer.teams else f"\nno team can: {agents} could be in one")
    for rank, team in enumerate(answer.teams or (), 1):
        print(f"{rank:>4}  {printable(', '.join(offer.agent for offer in team))}")


def _table(offers: Sequence[Offer], attributes: _Attributes) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for column in ("RANK", "AGENTS", "HOST", "HOW", "SCORE", "ATTRIBUTES"):
        table.add_column(column, justify="right" if column in ("RANK", "SCORE") else "left")
    for rank, offer in enumerate(offers, 1):
        description = attributes.describe(offer.facts)
        table.add_row(str(rank), offer.agent, offer.host, how(offer), f"{offer.score:.3f}", description)
    return table


def how(offer: Offer) -> str:
    """The rules of an offer: `direct`, `by climb-lifts`, `by climb-lifts, composed by grip-and-climb`."""
    if offer.kind == "direct":
        return "direct"
    if offer.kind == "composed":
        return f"composed by {offer.rule}"
    (inner,) = offer.parts.values()
    return f"by {offer.rule}" if inner.kind == "direct" else f"by {offer.rule}, {how(inner)}"


def _is_composed(offer: Offer) -> bool:
    return offer.kind == "composed" or any(_is_composed(part) for part in offer.parts.values())


def _tree(text: str, offer: Offer, attributes: _Attributes) -> TreeBranch:
    """The parts of an offer below it; an equivalent one is replaced by its part."""
    while offer.kind == "equivalent":
        (offer,) = offer.parts.values()
    children = []
    for need, part in parts_of(offer).items():
        label = f"{need}: {part.agent} at {part.host}, {how(part)} {part.primitive}"
        stated = attributes.describe(part.facts)
        children.append(_tree(f"{label}; {stated}" if stated else label, part, attributes))
    return TreeBranch(text, tuple(children))
