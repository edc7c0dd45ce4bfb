"""The permitted places of `together`, `within`, `reserve` and `wait until`, and their operands."""

from __future__ import annotations

import math

from lfield.lang import messages, syntax
from lfield.lang.checker.conversions import require_type, unknown, with_article
from lfield.lang.checker.expressions import value
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import describe
from lfield.lang.tree import Binary, Expr, Literal_, Negate, ToReal
from lfield.lang.tree_traversal import left_spine
from lfield.lang.types import INT, REAL, UNKNOWN, ArrayType, ResourceType
from lfield.text.message_tables import FindingKind
from lfield.text.source_text import Span

_INSTEAD = {
    "together": "offer portals; the coordinator calls those of several resources at one time",
    "within": "the coordinator limits its calls of the portal; here, compare now() in a loop",
    "reserve": "the coordinator reserves resources; a resource has exclusive use of its devices",
}


def check_coordinator_block(body: BodyContext, keyword: Span) -> None:
    """Report one of these keywords outside of a coordinator."""
    unit = body.unit
    if unit.usage == "coordinator":
        return
    hint = _INSTEAD[keyword.text] if unit.usage == "resource" else None
    body.report(
        messages.COORDINATOR_KEYWORD,
        keyword,
        hint=hint,
        viewer=describe(unit),
        unit=unit.name,
        keyword=keyword.text,
    )


def check_within_seconds(body: BodyContext, raw: syntax.Expr) -> Expr:
    """Check the seconds of a `within`; a constant that leaves no time for any event is reported."""
    return _seconds(body, raw, messages.WITHIN_OVER)


def check_wait_seconds(body: BodyContext, raw: syntax.Expr) -> Expr:
    """Check the seconds of a `wait until`, likewise."""
    return _seconds(body, raw, messages.WAIT_SECONDS)


def check_wait_place(body: BodyContext, keyword: Span) -> None:
    """Report a `wait until` outside of the synchronized methods and portals of resources."""
    method, unit = body.method, body.unit
    if unit.usage != "resource" or not method.synchronized:
        name = "init" if method.kind == "init" else f"the {method.kind} '{method.name}'"
        place = describe(unit) if unit.function else f"{name} of {describe(unit)}"
        body.report(messages.WAIT_PLACE, keyword, place=place)


def _seconds(body: BodyContext, raw: syntax.Expr, rule: FindingKind) -> Expr:
    found = require_type(body.symbols, value(body, raw), REAL)
    seconds = None if found.type is UNKNOWN else constant_number(found)
    if seconds is not None and not seconds > 0:
        text = "no number (NaN)" if math.isnan(seconds) else f"{seconds:g}"
        body.report(rule, found.span, given=text)
    return found


def check_reserve_operand(body: BodyContext, raw: syntax.Expr) -> Expr:
    """Check the target of a `reserve`."""
    found = value(body, raw)
    kind = found.type
    while isinstance(kind, ArrayType):
        kind = kind.element
    unit = body.symbols.unit_of(kind)
    offer = unit is not None and unit.capability
    if kind is UNKNOWN or offer or isinstance(kind, ResourceType):
        return found
    body.report(messages.RESERVE_TYPE, found.span, given=with_article(found.type))
    return unknown(found.span)


def constant_number(expr: Expr) -> float | None:
    """The number of an expression of literals; None for any other one, and for one that throws."""
    match expr:
        case Literal_(value=int() | float() as number) if expr.type in (INT, REAL):
            return float(number)
        case ToReal():
            return constant_number(expr.operand)
        case Negate():
            found = constant_number(expr.operand)
            return None if found is None else -found
        case Binary():
            return _sum(expr)
    return None


def _sum(expr: Binary) -> float | None:
    """A chain of operators, from its first number on."""
    links = [*left_spine(expr, _left), expr]
    found = constant_number(links[0].left)
    for link in links:
        right = constant_number(link.right)
        found = None if found is None or right is None else _folded(link, found, right)
    return found


def _left(link: Binary) -> Binary | None:
    return link.left if isinstance(link.left, Binary) else None


def _folded(link: Binary, left: float, right: float) -> float | None:
    match link.op:
        case "+":
            return left + right
        case "-":
            return left - right
        case "*":
            return left * right
        case "/" if link.type == REAL:
            return left / right if right else math.nan if not left else math.copysign(math.inf, left * right)
    return None
