"""Conversion of types: the one implicit conversion of L (int to real), and the choice among methods.

Of the methods of one name an exact match is best, then the candidate with the fewest widenings. A single
candidate gets more precise messages: which argument is wrong, and how many are required.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

from msgspec import Struct

from lfield.lang import messages
from lfield.lang.checker.symbols import Symbols, device_in
from lfield.lang.tree import Expr, Literal_, Method, ToReal
from lfield.lang.types import (
    BOOLEAN,
    EXCEPTION,
    INT,
    NULL,
    REAL,
    STRING,
    UNKNOWN,
    DeviceType,
    FutureType,
    Type,
    distance,
    is_reference,
)
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Span
from lfield.text.suggestions import listed

#: The library function that turns a value of the first type into the second.
_FUNCTIONS = {
    (INT, STRING): "i2s",
    (REAL, STRING): "f2s",
    (BOOLEAN, STRING): "b2s",
    (REAL, INT): "f2i",
    (STRING, INT): "s2i",
    (STRING, REAL): "s2f",
}


def conversion_cost(actual: Type, expected: Type) -> int | None:
    """0 when a value fits unchanged, more when it is widened (int to real, a class to its base class),
    else None.
    """
    if UNKNOWN in (actual, expected) or actual == expected:
        return 0
    if actual == NULL:
        return 0 if is_reference(expected) and not isinstance(expected, DeviceType) else None
    return 1 if (actual, expected) == (INT, REAL) else distance(actual, expected)


def widened(value: Expr, expected: Type) -> Expr:
    """A value that fits, with the ToReal node if it is widened to real."""
    if value.type == INT and expected == REAL:
        return ToReal(value.span, REAL, value)
    return value


def require_type(
    symbols: Symbols, value: Expr, expected: Type, message: FindingKind = messages.MISMATCH, **values: object
) -> Expr:
    """The value as the expected type; when it does not fit, `message` reports {expected} and {given}."""
    if conversion_cost(value.type, expected) is not None:
        _note_exception_use(symbols, value, expected)
        return widened(value, expected)
    hint = conversion_hint(value.type, expected) or None
    symbols.report(
        message,
        value.span,
        hint=hint,
        expected=with_article(expected),
        given=with_article(value.type),
        **values,
    )
    return unknown(value.span)


def _note_exception_use(symbols: Symbols, value: Expr, expected: Type) -> None:
    """Marks an object that becomes an Exception as thrown; one with a device is reported: it would travel."""
    if expected != EXCEPTION:
        return
    unit = symbols.unit_of(value.type)
    if unit is not None and unit.kind == "class":
        unit.mark_thrown()
    if device := device_in(symbols, value.type):
        symbols.report(messages.DEVICE_THROWN, value.span, type=with_article(value.type), device=device)


def unknown(span: Span) -> Expr:
    """An expression with an error that is already reported."""
    return Literal_(span, UNKNOWN, None)


def conversion_hint(actual: Type, expected: Type) -> str:
    """The explicit conversion, or '' if there is none."""
    function = _FUNCTIONS.get((actual, expected))
    if function is not None:
        return f"convert it: {function}(...)"
    if isinstance(actual, FutureType) and actual.value == expected:
        return "wait for the result: f.await()"
    if expected == BOOLEAN and actual in (INT, REAL):
        return "compare it: ... != 0"
    if actual == NULL:
        return f"{expected} is never null; only objects, arrays, strings and proxies can be"
    if expected == BOOLEAN and is_reference(actual) and not isinstance(actual, DeviceType):
        return "compare it: ... != null"
    return ""


def with_article(kind: Type) -> str:
    """A type with its article, for messages."""
    name = str(kind)
    if name in ("null", "void"):
        return name
    return f"an {name}" if name[0] in "aeiouAEIO" else f"a {name}"


Chosen = TypeVar("Chosen")


class OverloadCandidate(Struct, Generic[Chosen], frozen=True):
    """A callable: its name, the types of its parameters, and its declaration."""

    name: str
    types: tuple[Type, ...]
    target: Chosen

    def __str__(self) -> str:
        return f"{self.name}({', '.join(map(str, self.types))})"

    def cost(self, arguments: Sequence[Expr]) -> int | None:
        """The number of widenings that a call needs; None when the arguments do not fit."""
        if len(arguments) != len(self.types):
            return None
        costs = [
            conversion_cost(value.type, expected)
            for value, expected in zip(arguments, self.types, strict=True)
        ]
        known = [c for c in costs if c is not None]
        return sum(known) if len(known) == len(costs) else None


def of_methods(methods: Sequence[Method]) -> list[OverloadCandidate[Method]]:
    """Methods as candidates."""
    return [OverloadCandidate(m.name, tuple(p.type for p in m.parameters), m) for m in methods]


def choose_overload(
    symbols: Symbols,
    span: Span,
    candidates: Sequence[OverloadCandidate[Chosen]],
    arguments: Sequence[Expr],
    hint: str | None = None,
) -> tuple[Chosen, list[Expr]] | None:
    """The best candidate and the converted arguments; None when there is none or an argument is in error.

    `hint` replaces the list of the candidates.
    """
    costs = [(c.cost(arguments), c) for c in candidates]
    fitting = [(price, c) for price, c in costs if price is not None]
    if not fitting:
        _report_mismatch(symbols, span, candidates, arguments, hint)
        return None
    lowest = min(price for price, _ in fitting)
    best = [c for price, c in fitting if price == lowest]
    if len(best) > 1:
        if all(value.type is not UNKNOWN for value in arguments):
            symbols.report(
                messages.AMBIGUOUS,
                span,
                name=best[0].name,
                given=_types(arguments),
                candidates=listed(map(str, best)),
            )
        return None
    chosen = best[0]
    for value, expected in zip(arguments, chosen.types, strict=True):
        _note_exception_use(symbols, value, expected)
    return chosen.target, [widened(v, expected) for v, expected in zip(arguments, chosen.types, strict=True)]


def _report_mismatch(
    symbols: Symbols,
    span: Span,
    candidates: Sequence[OverloadCandidate[Chosen]],
    arguments: Sequence[Expr],
    hint: str | None,
) -> None:
    if len(candidates) > 1:
        everything = listed(map(str, candidates))
        symbols.report(
            messages.NO_OVERLOAD,
            span,
            hint=hint,
            name=candidates[0].name,
            given=_types(arguments),
            candidates=everything,
        )
        return
    only = candidates[0]
    if len(arguments) != len(only.types):
        expected = f"{len(only.types) or 'no'} argument{'s' if len(only.types) != 1 else ''}"
        symbols.report(
            messages.ARGUMENT_COUNT, span, signature=only, expected=expected, given=len(arguments) or "none"
        )
        return
    for number, (value, expected_type) in enumerate(zip(arguments, only.types, strict=True), 1):
        if conversion_cost(value.type, expected_type) is None:
            symbols.report(
                messages.ARGUMENT_TYPE,
                value.span,
                hint=conversion_hint(value.type, expected_type) or None,
                number=number,
                signature=only,
                expected=with_article(expected_type),
                given=with_article(value.type),
            )


def _types(arguments: Sequence[Expr]) -> str:
    return ", ".join(str(value.type) for value in arguments)
