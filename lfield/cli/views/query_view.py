"""Answers to a query: as a table with trees below it, and as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Any

from lfield.capability.matching.explanation import no_provider_note, render_refusals
from lfield.capability.matching.plan_search import attributes_of
from lfield.capability.model import Primitive, Registry
from lfield.capability.offer import AgentSource, Fact, Offer, Rejection
from lfield.cli.views.score_view import score_lines, terms_json
from lfield.cli.views.trees import plain_console, print_tree
from lfield.errors import LfieldError
from lfield.operator.query_parser import CapabilityQuery
from lfield.operator.registry.sheets import printable, value_text
from lfield.operator.registry.taxonomy import TreeBranch

if TYPE_CHECKING:
    from rich.table import Table


#: Maximum number of attributes shown of an offer, the most relevant first; `--json` has all.
SHOWN = 6


@dataclass(frozen=True, slots=True)
class KnownTeam:
    """The team as far as it is known, and how: the hosts that answered, and why the others did not."""

    team: AgentSource
    answered: tuple[str, ...] = ()
    unanswered: Mapping[str, LfieldError] = field(default_factory=dict)

    @property
    def is_running(self) -> bool:
        """Whether any host answered."""
        return bool(self.answered)

    def __str__(self) -> str:
        if not self.is_running:
            why = "no host answered" if self.unanswered else "nothing is running"
            return f"from the files: {why}, live attributes are unknown"
        hosts = len(self.answered) + len(self.unanswered)
        return f"from the running team: {len(self.answered)} of {hosts} hosts answered"


@dataclass(frozen=True, slots=True)
class PrimitiveAnswer:
    """The providers of a primitive, best first, their number, and the refusals of other agents.

    `teams` are the best teams of these offers if requested, from `agents` candidates. `notes` are the
    omissions.
    """

    primitive: Primitive
    offers: Sequence[Offer]
    count: int
    refusals: Sequence[Rejection]
    notes: Sequence[str] = ()
    teams: Sequence[Sequence[Offer]] | None = None
    agents: int = 0
    is_truncated: bool = False


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

    def describe(self, facts: Mapping[str, Fact], most: int = SHOWN) -> str:
        """`nominal: payload 2 kg, speed 3 m/s; measured 3.0 s ago: battery 0.8`, and how many more."""
        first = sorted(facts, key=lambda name: (name not in self._named, not self._is_rated(name)))
        alike = groupby(first[:most], key=lambda name: facts[name].source)
        parts = [
            f"{source}: {', '.join(self._describe_fact(n, facts[n]) for n in names)}"
            for source, names in alike
        ]
        parts += [f"and {len(first) - most} more"] if len(first) > most else []
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

    shown = Table(box=None, pad_edge=False)
    for column in ("RANK", "WHO", "HOST", "HOW", "SCORE", "ATTRIBUTES"):
        shown.add_column(column, justify="right" if column in ("RANK", "SCORE") else "left")
    for rank, offer in enumerate(offers, 1):
        description = attributes.describe(offer.facts)
        shown.add_row(str(rank), offer.agent, offer.host, how(offer), f"{offer.score:.3f}", description)
    return shown


def how(offer: Offer) -> str:
    """By which rules: `direct`, `by climb-lifts`, `by climb-lifts, composed by grip-and-climb`."""
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


# --- as JSON ------------------------------------------------------------------------------------------


def as_json(
    question: CapabilityQuery, known: KnownTeam, answers: Sequence[PrimitiveAnswer], registry: Registry
) -> str:
    """The whole answer; lfield/docs/operations.md has its shape."""
    constraint = question.constraint
    whole = {
        "query": question.text,
        "constraint": constraint.text.strip() if constraint is not None else None,
        "source": "team" if known.is_running else "files",
        "answered": list(known.answered),
        "silent": {host: str(why) for host, why in known.unanswered.items()},
        "codes": {host: why.code for host, why in known.unanswered.items()},
        "capabilities": [
            {
                "primitive": answer.primitive.name,
                "id": answer.primitive.id,
                "count": answer.count,
                "notes": list(answer.notes),
                "teams": None
                if answer.teams is None
                else [[offer.agent for offer in team] for team in answer.teams],
                "offers": [_offer(offer, registry) for offer in answer.offers],
                "refusals": [_refusal(refusal) for refusal in answer.refusals],
            }
            for answer in answers
        ],
    }
    return json.dumps(whole, indent=2)


def _offer(offer: Offer, registry: Registry) -> dict[str, Any]:
    return {
        "primitive": offer.primitive,
        "agent": offer.agent,
        "host": offer.host,
        "kind": offer.kind,
        "rule": offer.rule or None,
        "score": round(offer.score, 6),
        **terms_json(offer),
        "attributes": {name: _fact(name, fact, registry) for name, fact in offer.facts.items()},
        "parts": {need: _offer(part, registry) for need, part in parts_of(offer).items()},
    }


def parts_of(offer: Offer) -> dict[str, Offer]:
    """The parts by the names of their needs; `by` for the provider of an equivalent offer."""
    if offer.kind == "equivalent":
        (inner,) = offer.parts.values()
        return {"by": inner}
    # ways.part: the name of the whole, which is the way, and that of the need.
    return {way.removeprefix(f"{offer.way}_"): part for way, part in offer.parts.items()}


def _fact(name: str, fact: Fact, registry: Registry) -> dict[str, Any]:
    value = sorted(fact.value) if isinstance(fact.value, frozenset) else fact.value
    return {"value": value, "unit": unit_of(registry, name), "age": round(fact.age, 3), "source": fact.of}


def _refusal(refusal: Rejection) -> dict[str, Any]:
    inner = [_refusal(below) for below in refusal.inner]
    return {"subject": refusal.subject, "reasons": list(refusal.reasons), "inner": inner}


def unit_of(registry: Registry, attribute: str) -> str:
    """The unit of an attribute, '' when it has none."""
    return registry.attributes[attribute].unit if attribute in registry.attributes else ""
