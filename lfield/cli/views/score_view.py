"""Every term of a score: the formula of the ranking (capability/matching/ranking.py) with its numbers.

1: score 0.408 = 1 / (1 + cost)
  cost 1.45 = 0.85 + loss 2 * 0.3
    copter: cost 0.85 = fitness 1 * 0.65 + hop 0.1 * 1 + near 0.2 * 0 + age 0.2 * 0.5
      fitness 0.65 = payload 0.5 * 0.8 + battery 0.5 * 0.5
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from lfield.capability.offer import Offer


def score_lines(offers: Sequence[Offer]) -> Iterator[str]:
    """The scores of some offers by their ranks, with all their terms."""
    for rank, offer in enumerate(offers, 1):
        yield f"{rank}: score {offer.score:.3f} = 1 / (1 + cost)"
        yield from _cost_lines(offer, "  ", "")


def _cost_lines(offer: Offer, indent: str, owner: str) -> Iterator[str]:
    summands = [_rounded_text(part.cost) for part in offer.parts.values()]
    summands += [
        f"{term.name} {_rounded_text(term.weight)} * {_rounded_text(term.amount)}" for term in offer.terms
    ]
    yield f"{indent}{owner}cost {_rounded_text(offer.cost)} = {' + '.join(summands)}"
    if offer.penalties:
        shares = [
            f"{p.attribute} {_rounded_text(p.share)} * {_rounded_text(p.penalty)}" for p in offer.penalties
        ]
        fitness = sum(p.share * p.penalty for p in offer.penalties)
        yield f"{indent}  fitness {_rounded_text(fitness)} = {' + '.join(shares)}"
    for part in offer.parts.values():
        yield from _cost_lines(part, f"{indent}  ", f"{part.agent}, {part.primitive}: ")


def _rounded_text(number: float) -> str:
    return f"{number:.4g}"
