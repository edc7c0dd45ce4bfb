"""An offer of the matcher as the machine writes it into a block."""

from __future__ import annotations

import math
from collections.abc import Mapping

from lfield.capability.model import Value
from lfield.capability.offer import Offer
from lfield.vm.offers import Found


def found(offer: Offer, numbers: Mapping[str, int]) -> Found:
    """The offer with its parts; `numbers` are those of the agents in the deployment."""
    facts = offer.facts
    return Found(
        offer.way,
        offer.agent,
        offer.host,
        offer.kind,
        offer.score,
        numbers[offer.agent] if offer.kind == "direct" else -1,
        {name: found(part, numbers) for name, part in offer.parts.items()},
        tuple(facts),
        tuple([_number(fact.value) for fact in facts.values()]),
        tuple([_text(fact.value) for fact in facts.values()]),
        tuple([fact.age for fact in facts.values()]),
    )


def _number(value: Value) -> float:
    return float(value) if isinstance(value, bool | int | float) else math.nan


def _text(value: Value) -> str | None:
    """The value in words; None for a number, which says it best itself."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, frozenset):
        return ", ".join(sorted(value))
    return value if isinstance(value, str) else None
