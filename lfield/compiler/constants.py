"""Constants: folding what is exact and trivial, and the pool of a program."""

from __future__ import annotations

import struct
from enum import Enum

from lfield.lang.chains import chain
from lfield.lang.tree import Binary, Expr, Literal_, Negate, Not, ToReal

Constant = bool | int | float | str | None


class Unknown(Enum):
    """The answer of `fold` for what is only known at run time (None is the constant null)."""

    VALUE = "unknown"


_INT_MIN, _INT_MAX = -(1 << 63), (1 << 63) - 1


def fold(expr: Expr) -> Constant | Unknown:
    """The value of an expression made of literals, where it is the same on every machine.

    Ints that would overflow are left to the machine, which throws; reals are only negated and widened.
    The checker has seen to it that only numbers are calculated with, so a bool is never taken for an int.
    """
    match expr:
        case Literal_():
            return expr.value
        case Negate():
            return _negate(fold(expr.operand))
        case ToReal():
            value = fold(expr.operand)
            return float(value) if isinstance(value, int) else Unknown.VALUE
        case Not():
            value = fold(expr.operand)
            return not value if isinstance(value, bool) else Unknown.VALUE
        case Binary(op="+" | "-" | "*"):
            return _sum(expr)
    return Unknown.VALUE


def _sum(expr: Binary) -> Constant | Unknown:
    """The value of `1 + 2 - 3 * 4`, from the left. Most begin with none and are over at once."""
    first: Expr = expr
    while isinstance(first, Binary):
        first = first.left
    value = fold(first)
    for link in [*chain(expr, _before), expr] if isinstance(value, int) else []:
        right = fold(link.right)
        if not isinstance(value, int) or not isinstance(right, int):
            return Unknown.VALUE
        value = _arithmetic(link.op, value, right)
    return value if isinstance(value, int) else Unknown.VALUE


def _before(link: Binary) -> Binary | None:
    return link.left if isinstance(link.left, Binary) else None


def _negate(value: Constant | Unknown) -> Constant | Unknown:
    if isinstance(value, float):
        return -value
    return _within(-value) if isinstance(value, int) else Unknown.VALUE


def _arithmetic(op: str, left: int, right: int) -> int | Unknown:
    results = {"+": left + right, "-": left - right, "*": left * right}
    return _within(results[op]) if op in results else Unknown.VALUE


def _within(value: int) -> int | Unknown:
    return value if _INT_MIN <= value <= _INT_MAX else Unknown.VALUE


class Pool:
    """Every constant of a program once. Kinds are kept apart, and reals by their bits: 0.0 is not -0.0."""

    def __init__(self) -> None:
        self.values: list[Constant] = []
        self._numbers: dict[tuple[type, Constant | bytes], int] = {}

    def number(self, value: Constant) -> int:
        """The number of a constant."""
        key = (type(value), struct.pack("<d", value) if isinstance(value, float) else value)
        if key not in self._numbers:
            self._numbers[key] = len(self.values)
            self.values.append(value)
        return self._numbers[key]

    def operand(self, value: Constant) -> int:
        """A constant as a source operand."""
        return -1 - self.number(value)
