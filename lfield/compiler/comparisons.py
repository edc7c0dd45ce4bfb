"""Comparisons (table J.8): which instruction, and in which order.

Only the last source operand of an instruction may be a constant, so `0 < x` becomes `x > 0`.
"""

from __future__ import annotations

from lfield.compiler.constants import Unknown, fold
from lfield.lang import types
from lfield.lang.tree import Binary, Expr

_NAMES = {"==": "eq", "!=": "sne", "<": "slt", "<=": "sle", ">": "sgt", ">=": "sge"}
_SUFFIXES = {types.INT: "i", types.REAL: "f", types.STRING: "s", types.BOOLEAN: "b"}
#: The operator that says the same with its sides exchanged.
_MIRRORED = {"+": "+", "*": "*", "==": "==", "!=": "!=", "<": ">", "<=": ">=", ">": "<", ">=": "<="}


def constant_last(expr: Binary) -> tuple[Expr, Expr]:
    """The sides of an operation, exchanged when that makes a constant the last one.

    A constant has no effect, so the order of evaluation stays what the source says.
    """
    if expr.op in _MIRRORED and not isinstance(fold(expr.left), Unknown | str):
        return expr.right, expr.left
    return expr.left, expr.right


def instruction(expr: Binary) -> tuple[str, Expr, Expr]:
    """The comparison instruction, and its source operands in order."""
    left, right = constant_last(expr)
    op = expr.op if left is expr.left else _MIRRORED[expr.op]
    return _NAMES[op] + _SUFFIXES.get(expr.left.type, "r"), left, right


def tested_for_null(expr: Expr) -> Expr | None:
    """The side that is compared with null, if one is."""
    if not isinstance(expr, Binary) or expr.op not in ("==", "!="):
        return None
    if fold(expr.right) is None:
        return expr.left
    return expr.right if fold(expr.left) is None else None
