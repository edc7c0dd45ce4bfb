"""Constants: folding if it is exact, and the constant pool of a program."""

from __future__ import annotations

import struct
from enum import Enum

from lfield.lang.tree import Binary, Expr, Literal_, Negate, Not, Relabel, ToReal
from lfield.lang.tree_traversal import left_spine

Constant = bool | int | float | str | None


class NotConstant(Enum):
    """Result of `fold` for a value that is known only at run time (None is the constant null)."""

    VALUE = "unknown"


_INT_MIN, _INT_MAX = -(1 << 63), (1 << 63) - 1


def fold(expr: Expr) -> Constant | NotConstant:
    """The value of an expression of literals, if it is the same on every machine.

    Ints that would overflow are left to the machine, which throws; reals are only negated and widened.
    The checker allows arithmetic only on numbers, so a bool cannot be mistaken for an int.
    """
    match expr:
        case Literal_():
            return expr.value
        case Negate():
            return _negate(fold(expr.operand))
        case Relabel():
            return fold(expr.operand)
        case ToReal():
            value = fold(expr.operand)
            return float(value) if isinstance(value, int) else NotConstant.VALUE
        case Not():
            value = fold(expr.operand)
            return not value if isinstance(value, bool) else NotConstant.VALUE
        case Binary(op="+" | "-" | "*"):
            return _sum(expr)
    return NotConstant.VALUE


def _sum(expr: Binary) -> Constant | NotConstant:
    """The value of `1 + 2 - 3 * 4`, from the left. Most sums start without a constant and end at once."""
    first: Expr = expr
    while isinstance(first, Binary):
        first = first.left
    value = fold(first)
    for link in [*left_spine(expr, _preceding), expr] if isinstance(value, int) else []:
        right = fold(link.right)
        if not isinstance(value, int) or not isinstance(right, int):
            return NotConstant.VALUE
        value = _arithmetic(link.op, value, right)
    return value if isinstance(value, int) else NotConstant.VALUE


def _preceding(link: Binary) -> Binary | None:
    return link.left if isinstance(link.left, Binary) else None


def _negate(value: Constant | NotConstant) -> Constant | NotConstant:
    if isinstance(value, float):
        return -value
    return _int64(-value) if isinstance(value, int) else NotConstant.VALUE


def _arithmetic(op: str, left: int, right: int) -> int | NotConstant:
    results = {"+": left + right, "-": left - right, "*": left * right}
    return _int64(results[op]) if op in results else NotConstant.VALUE


def _int64(value: int) -> int | NotConstant:
    return value if _INT_MIN <= value <= _INT_MAX else NotConstant.VALUE


class ConstantPool:
    """The constants of a program without duplicates, by kind; reals by their bits: 0.0 is not -0.0."""

    def __init__(self) -> None:
        self.values: list[Constant] = []
        self._numbers: dict[tuple[type, Constant | bytes], int] = {}

    def number(self, value: Constant) -> int:
        """The index of a constant."""
        key = (type(value), struct.pack("<d", value) if isinstance(value, float) else value)
        if key not in self._numbers:
            self._numbers[key] = len(self.values)
            self.values.append(value)
        return self._numbers[key]

    def operand(self, value: Constant) -> int:
        """A constant as a source operand."""
        return -1 - self.number(value)
