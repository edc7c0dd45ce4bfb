"""Answers to capability queries, and as JSON data, as of `lfield query --json`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msgspec import Struct, field

from lfield.capability.model import Registry
from lfield.capability.offer import AgentSource, Fact, Offer, Rejection
from lfield.errors import LfieldError
from lfield.operator.query_parser import CapabilityQuery
from lfield.operator.team_query import PrimitiveAnswer


class KnownTeam(Struct, frozen=True):
    """The known team: the hosts that answered, and the reasons why the others did not."""

    team: AgentSource
    answered: tuple[str, ...] = ()
    unanswered: Mapping[str, LfieldError] = field(default_factory=dict)

    @property
    def is_running(self) -> bool:
        """Whether any host answered."""
        return bool(self.answered)

    def __str__(self) -> str:
        if not self.is_running:
            reason = "no host answered" if self.unanswered else "nothing is running"
            return f"from the files: {reason}, live attributes are unknown"
        hosts = len(self.answered) + len(self.unanswered)
        return f"from the running team: {len(self.answered)} of {hosts} hosts answered"


def query_data(
    question: CapabilityQuery, known_team: KnownTeam, answers: Sequence[PrimitiveAnswer], registry: Registry
) -> dict[str, Any]:
    """The whole answer; lfield/docs/operations.md has its shape."""
    constraint = question.constraint
    return {
        "query": question.text,
        "constraint": constraint.text.strip() if constraint is not None else None,
        "source": "team" if known_team.is_running else "files",
        "answered": list(known_team.answered),
        "silent": {host: str(error) for host, error in known_team.unanswered.items()},
        "codes": {host: error.code for host, error in known_team.unanswered.items()},
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
    # realisations.part: the name of the whole, which is the realisation, and that of the need.
    return {field.removeprefix(f"{offer.realisation}_"): part for field, part in offer.parts.items()}


def _fact(name: str, fact: Fact, registry: Registry) -> dict[str, Any]:
    value = sorted(fact.value) if isinstance(fact.value, frozenset) else fact.value
    return {"value": value, "unit": unit_of(registry, name), "age": round(fact.age, 3), "source": fact.of}


def _refusal(refusal: Rejection) -> dict[str, Any]:
    inner = [_refusal(below) for below in refusal.inner]
    return {"subject": refusal.subject, "reasons": list(refusal.reasons), "inner": inner}


def unit_of(registry: Registry, attribute: str) -> str:
    """The unit of an attribute, '' when it has none."""
    return registry.attributes[attribute].unit if attribute in registry.attributes else ""


def terms_json(offer: Offer) -> dict[str, Any]:
    """The cost of an offer with its terms and penalties; those of its parts follow with the parts."""
    return {
        "cost": offer.cost,
        "terms": {term.name: {"weight": term.weight, "amount": term.amount} for term in offer.terms},
        "fitness": {
            penalty.attribute: {"share": penalty.share, "penalty": penalty.penalty}
            for penalty in offer.penalties
        },
    }
