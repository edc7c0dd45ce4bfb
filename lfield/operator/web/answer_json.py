"""Results of queries and orders as JSON for the page: rows and lines of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from lfield.capability.matching.explanation import no_provider_note, render_refusals
from lfield.capability.offer import Offer
from lfield.operator.dashboard.operator_actions import OrderOutcome, QueryAnswer
from lfield.operator.registry.sheets import value_text
from lfield.operator.team_query import PrimitiveAnswer

#: Maximum number of attributes shown of an offer; `lfield query --json` has all.
MAX_FACTS = 6


def query_json(answer: QueryAnswer) -> bytes:
    """The answer to a query as JSON."""
    return msgspec.json.encode(
        {
            "question": answer.question,
            "errors": answer.mistakes,
            "unreachable": answer.unanswered,
            "answers": [_found(found, answer.units) for found in answer.found],
        }
    )


def _found(found: PrimitiveAnswer, units: Mapping[str, str]) -> dict[str, Any]:
    name = found.primitive.name
    return {
        "primitive": name,
        "id": found.primitive.id,
        "count": found.count,
        "notes": list(found.notes),
        "offers": [_offer(offer, units) for offer in found.offers],
        "refusals": render_refusals(found.refusals)
        if found.count or found.refusals
        else no_provider_note(name),
    }


def _offer(offer: Offer, units: Mapping[str, str]) -> dict[str, Any]:
    facts = list(offer.facts.items())[:MAX_FACTS]
    return {
        "agent": offer.agent,
        "host": offer.host,
        # The hosts of the parts of a composed offer.
        "hosts": sorted({part.host for part in offer.parts.values()} or {offer.host}),
        "how": "direct" if offer.kind == "direct" else f"by {offer.rule}",
        "score": offer.score,
        "facts": [f"{name} {value_text(fact.value, units.get(name, ''))}" for name, fact in facts],
        # One level only: `lfield query` draws the whole tree.
        "parts": [f"{part.agent} at {part.host}: {part.primitive}" for part in offer.parts.values()],
    }


def order_json(order: OrderOutcome) -> bytes:
    """The result of an order as JSON."""
    return msgspec.json.encode({**msgspec.to_builtins(order), "is_complete": order.is_complete})
