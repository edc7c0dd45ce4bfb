"""The answer to a question as the page shows it: plain rows and lines of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec

from lfield.capability.matching.explain import nobody_serves, render
from lfield.capability.offer import Offer
from lfield.operator.registry.sheets import worth
from lfield.operator.sight.actions import Answer, Found, Ordered

#: So many attributes of an offer are shown; `lfield query --json` has all.
SHOWN = 6


def answered(answer: Answer) -> bytes:
    """An answer as JSON."""
    return msgspec.json.encode(
        {
            "question": answer.question,
            "mistakes": answer.mistakes,
            "unheard": answer.unheard,
            "found": [_found(found) for found in answer.found],
        }
    )


def _found(found: Found) -> dict[str, Any]:
    name = found.primitive.name
    return {
        "primitive": name,
        "id": found.primitive.id,
        "count": found.count,
        "notes": list(found.notes),
        "offers": [_offer(offer, found.units) for offer in found.offers],
        "refusals": render(found.refusals) if found.count or found.refusals else nobody_serves(name),
    }


def _offer(offer: Offer, units: Mapping[str, str]) -> dict[str, Any]:
    told = list(offer.facts.items())[:SHOWN]
    return {
        "agent": offer.agent,
        "host": offer.host,
        # Of one that is composed those of its parts.
        "hosts": sorted({part.host for part in offer.parts.values()} or {offer.host}),
        "how": "direct" if offer.kind == "direct" else f"by {offer.rule}",
        "score": offer.score,
        "facts": [f"{name} {worth(fact.value, units.get(name, ''))}" for name, fact in told],
        # What stands in for it, or what it is composed of: `lfield query` draws the whole tree.
        "parts": [f"{part.agent} at {part.host}: {part.primitive}" for part in offer.parts.values()],
    }


def ordered(order: Ordered) -> bytes:
    """What came of an order, as JSON."""
    return msgspec.json.encode({**msgspec.to_builtins(order), "well": order.well})
