"""Operators: arithmetic, comparison, logic."""

from __future__ import annotations

from typing import Literal, cast

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import conversion_cost, unknown, widened
from lfield.lang.checker.scope import BodyContext
from lfield.lang.types import (
    BOOLEAN,
    INT,
    NULL,
    REAL,
    STRING,
    UNKNOWN,
    ArrayType,
    EnumType,
    Type,
    distance,
    is_numeric,
    is_reference,
)

_ORDER = ("<", "<=", ">", ">=")
_EQUALITY = ("==", "!=")
#: The correct form instead of an operator that does not work on text.
_NOT_JOINING = {
    "*": "repeat text in a loop: for (int i = 0; i < n; i += 1) s = s + t;",
    "%": 'join text with +, as in "n is " + i2s(n)',
}
_TO_STRING = {INT: "i2s", REAL: "f2s", BOOLEAN: "b2s"}


def unary(body: BodyContext, raw: syntax.Unary, operand: tree.Expr) -> tree.Expr:
    """`!operand` or `-operand`."""
    kind = operand.type
    if kind is UNKNOWN:
        return operand
    if raw.operator == "!" and kind == BOOLEAN:
        return tree.Not(raw.span, BOOLEAN, operand)
    if raw.operator == "-" and is_numeric(kind):
        return tree.Negate(raw.span, kind, operand)
    hint = "! negates a boolean: did you mean == 0 ?" if raw.operator == "!" and is_numeric(kind) else None
    body.report(messages.OPERAND, raw.span, hint=hint, operator=raw.operator, given=kind)
    return unknown(raw.span)


def binary(body: BodyContext, raw: syntax.Binary, left: tree.Expr, right: tree.Expr) -> tree.Expr:
    """Any operator with two sides."""
    if UNKNOWN in (left.type, right.type):
        return unknown(raw.span)
    if raw.operator in ("&&", "||"):
        if left.type == right.type == BOOLEAN:
            return tree.Logical(raw.span, BOOLEAN, cast(Literal["&&", "||"], raw.operator), left, right)
        return _report_operands(body, raw, left, right)
    if raw.operator in _EQUALITY:
        return _equality(body, raw, left, right)
    left, right = _widened(left, right)
    kind = left.type
    works = is_numeric(kind) or (kind == STRING and raw.operator in ("+", *_ORDER))
    works = works or (isinstance(kind, EnumType) and raw.operator in _ORDER)
    if kind != right.type or not works:
        return _report_operands(body, raw, left, right)
    return _binary_node(raw, BOOLEAN if raw.operator in _ORDER else kind, left, right)


def _equality(body: BodyContext, raw: syntax.Binary, left: tree.Expr, right: tree.Expr) -> tree.Expr:
    """`==` and `!=`. A null is moved to the right, so that the left side has the type."""
    left, right = _widened(left, right)
    if left.type == NULL:
        left, right = right, left
    if _comparable(left.type, right.type):
        return _binary_node(raw, BOOLEAN, left, right)
    hint = None
    if NULL in (left.type, right.type):
        hint = f"{left.type} is never null"
    elif STRING in (left.type, right.type):
        hint = _string_hint(left.type, right.type)
    body.report(messages.INCOMPARABLE, raw.sign, hint=hint, left=left.type, right=right.type)
    return unknown(raw.span)


def _comparable(left: Type, right: Type) -> bool:
    if right == NULL:
        return is_reference(left)
    return distance(left, right) is not None or distance(right, left) is not None


def _widened(left: tree.Expr, right: tree.Expr) -> tuple[tree.Expr, tree.Expr]:
    """Both sides as real when one is real and the other int."""
    if conversion_cost(left.type, right.type) == 1:
        return widened(left, right.type), right
    if conversion_cost(right.type, left.type) == 1:
        return left, widened(right, left.type)
    return left, right


def _binary_node(raw: syntax.Binary, kind: Type, left: tree.Expr, right: tree.Expr) -> tree.Expr:
    return tree.Binary(raw.span, kind, cast(tree.BinaryOp, raw.operator), left, right)


def _report_operands(body: BodyContext, raw: syntax.Binary, left: tree.Expr, right: tree.Expr) -> tree.Expr:
    operator = raw.operator
    hint = None
    if operator in ("&&", "||"):
        hint = "both sides must be boolean: compare them with something"
    elif operator in _ORDER and BOOLEAN in (left.type, right.type):
        hint = "join two comparisons: a < b && b < c"
    elif STRING in (left.type, right.type) and operator != "+":
        hint = _NOT_JOINING.get(operator, "of operators only + and comparisons work on text")
    elif STRING in (left.type, right.type) and left.type != right.type:
        hint = _string_hint(left.type, right.type)
    elif isinstance(left.type, ArrayType) or isinstance(right.type, ArrayType):
        hint = "operators work on single elements: write a loop over the array"
    body.report(messages.OPERANDS, raw.sign, hint=hint, operator=operator, left=left.type, right=right.type)
    return unknown(raw.span)


def _string_hint(left: Type, right: Type) -> str | None:
    """The hint for converting the side that is not a string."""
    if isinstance(left, EnumType) or isinstance(right, EnumType):
        return "a member of an enum has its name as text: member.name()"
    function = _TO_STRING.get(left) or _TO_STRING.get(right)
    return f"convert the other operand to a string: {function}(...)" if function else None
