"""The begun twin of a method that stands for a portal of an offer: what a `together` calls instead.

    public real lift(real height) {               the twin, with the ticket and the place of the result
        if (byCrane != null) {
            return byCrane.lift(height);          begins byCrane.lift(height)
        }
        if (as_climb_lifts != null) {
            as_climb_lifts.climb(height);         worked in place, as this is
            return height;                        settles height; return
        }
        ...

The resource that serves a portal itself works beside the others. Every other way has steps of its own, so it
is gone through when the block comes to it; what it gives waits with the results of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from lfield.lang import types
from lfield.lang.chains import statements
from lfield.lang.tree import (
    Begin,
    Block,
    Call,
    Element,
    Evaluate,
    Expr,
    If,
    Local,
    LocalGet,
    Method,
    PortalCall,
    Return,
    Stmt,
)
from lfield.lang.types import Type, array_of

#: The type of the parameter that says whose call it is; the language has no such values.
TICKET = Type("ticket")


@dataclass(slots=True, eq=False)
class Settle(Stmt):
    """What was gone through in place has given a value: `target` takes it when the block ends."""

    value: Expr
    target: Element


@dataclass(frozen=True, slots=True)
class Twin:
    """The twin's method, and its parameter for the ticket."""

    method: Method
    ticket: Local


def begun_offers(methods: Iterable[Method]) -> list[Method]:
    """The methods of offers that some `together` begins, each once."""
    found: dict[Method, None] = {}
    for method in methods:
        for one in statements(method.body):
            if isinstance(one, Begin) and isinstance(one.call, Call):
                found[one.call.method] = None
    return list(found)


def twin_of(method: Method) -> Twin:
    """The twin: its last parameters are the ticket and, where there is a result, an array (or null) and an
    index in it."""
    ticket = Local("", TICKET, method.span)
    place: Element | None = None
    added = [ticket]
    if method.result != types.VOID:
        array = Local("", array_of(method.result), method.span)
        index = Local("", types.INT, method.span)
        into = LocalGet(method.span, array.type, array), LocalGet(method.span, types.INT, index)
        place = Element(method.span, method.result, *into)
        added += [array, index]
    made = replace(
        method,
        parameters=[*method.parameters, *added],
        result=types.VOID,
        body=_steps(method.body, place),
    )
    return Twin(made, ticket)


def _steps(body: Sequence[Stmt], place: Element | None) -> list[Stmt]:
    match body:
        case [*before, Evaluate(value=PortalCall() as call), Return(value=None) as back]:
            return [*_steps(before, place), Begin(call.span, call, None), back]
    return [step for one in body for step in _step(one, place)]


def _step(one: Stmt, place: Element | None) -> list[Stmt]:
    match one:
        case Return(value=PortalCall() as call):
            return [Begin(one.span, call, place), Return(one.span, None)]
        case Return(value=Expr() as value) if place is not None:
            return [Settle(value.span, value, place), Return(one.span, None)]
        case If():
            return [replace(one, then=_steps(one.then, place), otherwise=_steps(one.otherwise, place))]
        case Block():
            return [replace(one, body=_steps(one.body, place))]
    return [one]
