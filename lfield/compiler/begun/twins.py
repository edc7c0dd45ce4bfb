"""The begun twin of a method that stands for a portal of an offer: what a `together` calls instead.

    public real lift(real height) {               the twin, with the ticket and the place of the result
        if (byCrane != null) {
            return byCrane.lift(height);          begins byCrane.lift(height)
        }
        if (as_climb_lifts != null) {
            as_climb_lifts.climb(height);         begins as_climb_lifts.climb(height), by its twin
            return height;                        settles height; return
        }
        ...

A way that is one call works beside the others, whatever it is: of the resource itself, or of an equivalent
offer. Every other way has steps of its own (a composition), or makes something of the result: it is gone
through when the block comes to it, and what it gives waits with the results of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from lfield.lang import types
from lfield.lang.capabilities import OFFER_METHODS
from lfield.lang.chains import inside, statements
from lfield.lang.tree import (
    Begin,
    Binary,
    Block,
    Call,
    Element,
    Evaluate,
    Expr,
    If,
    Literal_,
    Local,
    LocalGet,
    Method,
    Negate,
    PortalCall,
    Return,
    Stmt,
    ToReal,
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


def twins_of(methods: Iterable[Method]) -> dict[Method, Twin]:
    """A twin for each method of an offer that some `together` begins, and for those that twins begin."""
    made: dict[Method, Twin] = {}
    waiting = _begun(methods)
    while waiting:
        method = waiting.pop(0)
        if method not in made:
            made[method] = twin_of(method)
            waiting += _begun([made[method].method])
    return made


def _begun(methods: Iterable[Method]) -> list[Method]:
    """The methods of offers that a `together` or a twin begins, each once."""
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
        case [*before, Evaluate(value=PortalCall() | Call() as call), Return(value=value) as back] if _begins(
            call
        ) and (value is None or _is_computed(value)):
            given = [] if value is None or place is None else [Settle(value.span, value, place)]
            begun = Begin(call.span, call, None)
            return [*_steps(before, place), begun, *given, Return(back.span, None)]
    return [step for one in body for step in _step(one, place)]


def _step(one: Stmt, place: Element | None) -> list[Stmt]:
    match one:
        case Return(value=PortalCall() | Call() as call) if _begins(call):
            return [Begin(one.span, call, place), Return(one.span, None)]
        case Return(value=Expr() as value) if place is not None:
            return [Settle(value.span, value, place), Return(one.span, None)]
        case If():
            return [replace(one, then=_steps(one.then, place), otherwise=_steps(one.otherwise, place))]
        case Block():
            return [replace(one, body=_steps(one.body, place))]
    return [one]


def _begins(call: PortalCall | Call) -> bool:
    """Whether a call is that of a portal, or of an offer's."""
    if isinstance(call, PortalCall):
        return True
    return call.method.unit.capability and call.method.name not in OFFER_METHODS


def _is_computed(value: Expr) -> bool:
    """Whether a value depends on nothing but what the method was given."""
    kinds = LocalGet | Literal_ | Binary | Negate | ToReal
    return all(isinstance(one, kinds) for one in inside(value))
