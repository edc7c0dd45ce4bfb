"""The choice among methods of one name by the types of the arguments.

An exact match is best, then the candidate with the fewest widenings. One candidate alone gets the more
precise messages: which argument is wrong, and how many are wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from lfield.lang import messages
from lfield.lang.checker.conversion import conversion_hint, converted, cost, shown
from lfield.lang.checker.symbols import Symbols
from lfield.lang.tree import Expr, Method
from lfield.lang.types import UNKNOWN, Type
from lfield.text.source import Span
from lfield.text.suggest import listed

Chosen = TypeVar("Chosen")


@dataclass(frozen=True, slots=True)
class Candidate(Generic[Chosen]):
    """Something that can be called: its name, the types of its parameters, and what it is."""

    name: str
    types: tuple[Type, ...]
    what: Chosen

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(str, self.types))})"

    def cost(self, given: Sequence[Expr]) -> int | None:
        """How many widenings a call needs; None when the arguments do not fit."""
        if len(given) != len(self.types):
            return None
        costs = [cost(value.type, wanted) for value, wanted in zip(given, self.types, strict=True)]
        known = [c for c in costs if c is not None]
        return sum(known) if len(known) == len(costs) else None


def of_methods(methods: Sequence[Method]) -> list[Candidate[Method]]:
    """Methods as candidates."""
    return [Candidate(m.name, tuple(p.type for p in m.parameters), m) for m in methods]


def choose(
    symbols: Symbols, span: Span, candidates: Sequence[Candidate[Chosen]], given: Sequence[Expr]
) -> tuple[Chosen, list[Expr]] | None:
    """The best candidate and the converted arguments; None when there is none or an argument is in error."""
    costs = [(c.cost(given), c) for c in candidates]
    fitting = [(price, c) for price, c in costs if price is not None]
    if not fitting:
        _report_misfit(symbols, span, candidates, given)
        return None
    least = min(price for price, _ in fitting)
    best = [c for price, c in fitting if price == least]
    if len(best) > 1:
        if all(value.type is not UNKNOWN for value in given):
            symbols.report(
                messages.AMBIGUOUS,
                span,
                name=best[0].name,
                given=_types(given),
                candidates=listed(map(str, best)),
            )
        return None
    chosen = best[0]
    return chosen.what, [converted(v, wanted) for v, wanted in zip(given, chosen.types, strict=True)]


def _report_misfit(
    symbols: Symbols, span: Span, candidates: Sequence[Candidate[Chosen]], given: Sequence[Expr]
) -> None:
    if len(candidates) > 1:
        everything = listed(map(str, candidates))
        symbols.report(
            messages.NO_OVERLOAD, span, name=candidates[0].name, given=_types(given), candidates=everything
        )
        return
    only = candidates[0]
    if len(given) != len(only.types):
        wanted = f"{len(only.types) or 'no'} argument{'s' if len(only.types) != 1 else ''}"
        symbols.report(
            messages.ARGUMENT_COUNT, span, signature=only, wanted=wanted, given=len(given) or "none"
        )
        return
    for number, (value, wanted_type) in enumerate(zip(given, only.types, strict=True), 1):
        if cost(value.type, wanted_type) is None:
            symbols.report(
                messages.ARGUMENT_TYPE,
                value.span,
                hint=conversion_hint(value.type, wanted_type) or None,
                number=number,
                signature=only,
                wanted=shown(wanted_type),
                given=shown(value.type),
            )


def _types(given: Sequence[Expr]) -> str:
    return ", ".join(str(value.type) for value in given)
