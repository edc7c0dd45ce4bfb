"""Calls of functions of the top level: each unit that calls one has it as a private method.

So a function runs like any other method, with the object of its caller, which it cannot name.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.lang import syntax, tree
from lfield.lang.checker.conversions import OverloadCandidate, choose_overload, unknown
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import Function
from lfield.lang.standard_library.instances import LibraryBody
from lfield.text.source_text import Span


def function_call(
    body: BodyContext, raw: syntax.Call, place: Span, functions: Sequence[Function], given: list[tree.Expr]
) -> tree.Expr:
    """`square(x)`: the overload that fits."""
    candidates = [
        OverloadCandidate(one.head.name, tuple(p.type for p in one.head.parameters), one) for one in functions
    ]
    chosen = choose_overload(body.symbols, place, candidates, given)
    if chosen is None:
        return unknown(raw.span)
    function, arguments = chosen
    method = _instance(body, function)
    return tree.Call(raw.span, method.result, body.this(raw.span), method, arguments)


def _instance(body: BodyContext, function: Function) -> tree.Method:
    """The method of the unit that the function is there; in the function itself, its head."""
    if body.unit.function:
        return function.head
    return body.symbols.library.method((body.unit, function), lambda: _copy(body.unit, function))


def _copy(unit: tree.Unit, function: Function) -> LibraryBody:
    head = function.head
    method = tree.Method(
        head.name,
        "method",
        unit,
        [tree.Local(p.name, p.type, p.span) for p in head.parameters],
        head.result,
        public=False,
        synchronized=False,
        span=head.span,
        end=head.end,
    )
    unit.add_library_method(method)
    return LibraryBody(method, function.written, {}, function=True)
