"""Who may write `together`, `within` and `reserve`; how long a `within` lasts, and what a `reserve` keeps."""

from __future__ import annotations

import math

from lfield.lang import messages, syntax
from lfield.lang.chains import chain
from lfield.lang.checker.expressions import value
from lfield.lang.checker.fitting import expect, shown, unknown
from lfield.lang.checker.scope import Body
from lfield.lang.checker.symbols import describe
from lfield.lang.tree import Binary, Expr, Literal_, Negate, ToReal
from lfield.lang.types import INT, REAL, UNKNOWN, ArrayType, ResourceType
from lfield.text.source import Span

_INSTEAD = {
    "together": "offer portals; the coordinator calls those of several resources at one time",
    "within": "the coordinator limits its calls of the portal; here, a loop asks now()",
    "reserve": "the coordinator keeps what it works with; a resource has its devices for itself",
}


def may_stand(body: Body, word: Span) -> None:
    """Report one of these words where no coordinator runs."""
    unit = body.unit
    if unit.usage == "coordinator":
        return
    hint = _INSTEAD[word.text] if unit.usage == "resource" else None
    body.report(
        messages.COORDINATOR_WORD, word, hint=hint, viewer=describe(unit), unit=unit.name, word=word.text
    )


def limit(body: Body, raw: syntax.Expr) -> Expr:
    """The seconds of a `within`; a constant that nothing can end in is reported."""
    found = expect(body.symbols, value(body, raw), REAL)
    seconds = None if found.type is UNKNOWN else constant(found)
    if seconds is not None and not seconds > 0:
        given = "no number (NaN)" if math.isnan(seconds) else f"{seconds:g}"
        body.report(messages.WITHIN_OVER, found.span, given=given)
    return found


def reserved(body: Body, raw: syntax.Expr) -> Expr:
    """What a `reserve` keeps."""
    found = value(body, raw)
    kind = found.type
    while isinstance(kind, ArrayType):
        kind = kind.element
    unit = body.symbols.named(kind)
    offer = unit is not None and unit.capability
    if kind is UNKNOWN or offer or isinstance(kind, ResourceType):
        return found
    body.report(messages.RESERVE_TYPE, found.span, given=shown(found.type))
    return unknown(found.span)


def constant(expr: Expr) -> float | None:
    """The number that an expression of literals is; None for any other one, and for one that throws."""
    match expr:
        case Literal_(value=int() | float() as number) if expr.type in (INT, REAL):
            return float(number)
        case ToReal():
            return constant(expr.operand)
        case Negate():
            found = constant(expr.operand)
            return None if found is None else -found
        case Binary():
            return _sum(expr)
    return None


def _sum(expr: Binary) -> float | None:
    """A chain of operators, from its first number on."""
    links = [*chain(expr, _left), expr]
    found = constant(links[0].left)
    for link in links:
        right = constant(link.right)
        found = None if found is None or right is None else _worked(link, found, right)
    return found


def _left(link: Binary) -> Binary | None:
    return link.left if isinstance(link.left, Binary) else None


def _worked(link: Binary, left: float, right: float) -> float | None:
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
