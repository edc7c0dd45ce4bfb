"""The asynchronous variant of an offer's portal method, which a `together` calls instead.

    public real lift(real height) {               the variant, with the ticket and the target of the result
        if (byCrane != null) {
            return byCrane.lift(height);          starts byCrane.lift(height)
        }
        if (as_climb_lifts != null) {
            as_climb_lifts.climb(height);         starts as_climb_lifts.climb(height), by its variant
            return height;                        settles height; return
        }
        ...

A realisation that is one call runs concurrently, whether of the resource itself or of an equivalent offer.
Any other realisation has several steps (a composition), or computes a value from the result: it is executed
synchronously when the block reaches it, and its result is stored with those of the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from msgspec import Struct
from msgspec.structs import replace

from lfield.lang import types
from lfield.lang.capability_port import OFFER_METHODS
from lfield.lang.tree import (
    Async,
    Binary,
    BlockStmt,
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
    StartCall,
    Stmt,
    ToReal,
)
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.lang.types import array_of


class SettleResult(Stmt, eq=False):
    """The result of a synchronously executed realisation: stored into `target` when the block ends."""

    value: Expr
    target: Element


class AsyncVariant(Struct, frozen=True):
    """The variant's method, and its ticket parameter."""

    method: Method
    ticket: Local


def async_variants_of(methods: Sequence[Method], *, has_futures: bool = False) -> dict[Method, AsyncVariant]:
    """A variant for each method of an offer that a `together` or an `async` starts, or another variant.

    `has_futures`: whether there is any `async`.
    """
    variants: dict[Method, AsyncVariant] = {}
    waiting = _started_methods(methods)
    if has_futures:
        waiting += _future_methods(methods)
    while waiting:
        method = waiting.pop(0)
        if method not in variants:
            variants[method] = async_variant_of(method)
            waiting += _started_methods([variants[method].method])
    return variants


def _started_methods(methods: Iterable[Method]) -> list[Method]:
    """The methods of offers that a `together` or a variant starts, without duplicates."""
    found: dict[Method, None] = {}
    for method in methods:
        for stmt in all_statements(method.body):
            if isinstance(stmt, StartCall) and isinstance(stmt.call, Call):
                found[stmt.call.method] = None
    return list(found)


def _future_methods(methods: Iterable[Method]) -> list[Method]:
    """The methods of offers that an `async` begins."""
    statements = (stmt for method in methods for stmt in all_statements(method.body))
    expressions = (value for stmt in statements for value in statement_expressions(stmt))
    started = (part.call for value in expressions for part in descendants(value) if isinstance(part, Async))
    return list(dict.fromkeys(call.method for call in started if isinstance(call, Call)))


def async_variant_of(method: Method) -> AsyncVariant:
    """The variant: its last parameters are the ticket and, if there is a result, an array (or null) and an
    index in it.
    """
    ticket = Local("", types.TICKET, method.span)
    place: Element | None = None
    added = [ticket]
    if method.result != types.VOID:
        array = Local("", array_of(method.result), method.span)
        index = Local("", types.INT, method.span)
        into = LocalGet(method.span, array.type, array), LocalGet(method.span, types.INT, index)
        place = Element(method.span, method.result, *into)
        added += [array, index]
    variant = replace(
        method,
        parameters=[*method.parameters, *added],
        result=types.VOID,
        body=_steps(method.body, place),
    )
    return AsyncVariant(variant, ticket)


def _steps(body: Sequence[Stmt], place: Element | None) -> list[Stmt]:
    match body:
        case [*before, Evaluate(value=PortalCall() | Call() as call), Return(value=value) as leave] if (
            _starts_call(call) and (value is None or _is_computed(value))
        ):
            results = [] if value is None or place is None else [SettleResult(value.span, value, place)]
            start = StartCall(call.span, call, None)
            return [*_steps(before, place), start, *results, Return(leave.span, None)]
    return [step for stmt in body for step in _step(stmt, place)]


def _step(stmt: Stmt, place: Element | None) -> list[Stmt]:
    match stmt:
        case Return(value=PortalCall() | Call() as call) if _starts_call(call):
            return [StartCall(stmt.span, call, place), Return(stmt.span, None)]
        case Return(value=Expr() as value) if place is not None:
            return [SettleResult(value.span, value, place), Return(stmt.span, None)]
        case If():
            return [replace(stmt, then=_steps(stmt.then, place), otherwise=_steps(stmt.otherwise, place))]
        case BlockStmt():
            return [replace(stmt, body=_steps(stmt.body, place))]
    return [stmt]


def _starts_call(call: PortalCall | Call) -> bool:
    """Whether a call is that of a portal, or of a method of an offer."""
    if isinstance(call, PortalCall):
        return True
    return call.method.unit.capability and call.method.name not in OFFER_METHODS


def _is_computed(value: Expr) -> bool:
    """Whether a value depends only on the parameters of the method."""
    kinds = LocalGet | Literal_ | Binary | Negate | ToReal
    return all(isinstance(part, kinds) for part in descendants(value))
