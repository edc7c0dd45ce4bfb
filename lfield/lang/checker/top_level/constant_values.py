"""The values of constant expressions, as the machine would compute them.

Only values that are the same on every computer are computed: literals, members of enums, and operators. A
calculation that would throw, or that has no finite result, is a mistake.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from lfield.lang import tree
from lfield.lang.tree_traversal import left_spine
from lfield.lang.types import REAL
from lfield.text.source_text import Span

Value = bool | int | float | str
_INT_MIN, _INT_MAX = -(1 << 63), (1 << 63) - 1

_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_SUMS: dict[str, Callable[[Any, Any], Any]] = {"+": operator.add, "-": operator.sub, "*": operator.mul}


class NotComputable(Exception):
    """An expression without a constant value; `problem` is '' if it is not constant at all."""

    def __init__(self, place: Span, problem: str = "", hint: str = "") -> None:
        super().__init__(problem)
        self.place, self.problem, self.hint = place, problem, hint


def constant_value(expr: tree.Expr) -> Value:
    """The value of a checked expression. Raises NotComputable. Chains of operators may have any length."""
    known: dict[tree.Expr, Value] = {}
    for operand in [*left_spine(expr, _left), expr]:
        known[operand] = _value(operand, known)
    return known[expr]


def _left(expr: tree.Expr) -> tree.Expr | None:
    return expr.left if isinstance(expr, tree.Binary | tree.Logical) else None


def _value(expr: tree.Expr, values: dict[tree.Expr, Value]) -> Value:
    """The value of an expression; that of its left operand may be known already."""
    match expr:
        case tree.Literal_(value=bool() | int() | float() | str() as value):
            return value
        case tree.Relabel():
            return constant_value(expr.operand)
        case tree.ToReal():
            return float(constant_value(expr.operand))
        case tree.Not():
            return not constant_value(expr.operand)
        case tree.Negate():
            # The checker has accepted numbers only.
            return _number(expr, operator.neg(constant_value(expr.operand)))  # type: ignore[arg-type]
        case tree.Logical():
            left = values[expr.left]
            right = constant_value(expr.right)
            return bool(left and right) if expr.op == "&&" else bool(left or right)
        case tree.Binary():
            return _binary(expr, values[expr.left], constant_value(expr.right))
    raise NotComputable(expr.span)


def _binary(expr: tree.Binary, left: Value, right: Value) -> Value:
    if expr.op in _COMPARISONS:
        return _COMPARISONS[expr.op](left, right)
    if expr.op in _SUMS:
        return _number(expr, _SUMS[expr.op](left, right))
    if not right:
        raise NotComputable(expr.span, "a division by zero", "divide by another value")
    if isinstance(left, int) and isinstance(right, int):
        return _number(expr, _whole(expr.op, left, right))
    assert isinstance(left, float)
    assert isinstance(right, float)
    return _number(expr, left / right if expr.op == "/" else math.fmod(left, right))


def _whole(op: str, left: int, right: int) -> int:
    """Division towards zero, and its remainder."""
    quotient = abs(left) // abs(right)
    quotient = quotient if (left < 0) == (right < 0) else -quotient
    return quotient if op == "/" else left - quotient * right


def _number(expr: tree.Expr, value: Value) -> Value:
    """A value that fits its type."""
    if isinstance(value, float) and not math.isfinite(value):
        raise NotComputable(expr.span, "no finite number", "reals range to about 1.8e308")
    if expr.type != REAL and isinstance(value, int) and not _INT_MIN <= value <= _INT_MAX:
        raise NotComputable(expr.span, "beyond 64 bits", "write a real, as in 1e19")
    return value
