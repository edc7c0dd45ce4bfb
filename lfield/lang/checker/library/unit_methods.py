"""Private methods that a unit has because it calls them: texts of the library in L, and top-level functions.

So these methods run like any other method, with the object of their caller. A function cannot name that
object.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lfield.lang import syntax, tree
from lfield.lang.checker.conversions import OverloadCandidate, choose_overload, unknown
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import Function
from lfield.lang.parser import parse_file
from lfield.lang.standard_library.instances import LibraryBody
from lfield.lang.types import BOOLEAN, INT, STRING, VOID, Type, array_of
from lfield.text.source_text import Diagnostics, Source, Span

_PLAIN = {"int": INT, "boolean": BOOLEAN, "string": STRING, "void": VOID}


def text_call(
    body: BodyContext,
    raw: syntax.Call,
    name: str,
    text: str,
    types: Mapping[str, Type],
    arguments: Sequence[tree.Expr],
    result: Type,
) -> tree.Call:
    """The call of the method of that name in a text, in which names of types mean these `types`."""
    key = (body.unit, body.function, name, text, tuple(types.values()))
    instance = body.symbols.library.method(key, lambda: _instance(body, name, text, types))
    return tree.Call(raw.span, result, body.this(raw.span), instance, list(arguments))


def _instance(body: BodyContext, name: str, text: str, types: Mapping[str, Type]) -> LibraryBody:
    """The method of that name in the unit of the body; its own body is checked later."""
    source = body.symbols.library.source(text)
    written = next(method for method in _parsed(source) if method.name == name)
    kinds = {**_PLAIN, **types, **{f"{name}[]": array_of(kind) for name, kind in types.items()}}
    method = tree.Method(
        name,
        "method",
        body.unit,
        [tree.Local(p.name, kinds[str(p.type)], p.span) for p in written.parameters],
        kinds[str(written.result or "void")],
        public=False,
        synchronized=False,
        span=written.span,
        end=written.end,
    )
    body.unit.add_library_method(method)
    return LibraryBody(method, written, types, body.function)


def _parsed(source: Source) -> list[syntax.Method]:
    return parse_file(source, Diagnostics()).units[0].methods


# --- functions of the top level ---------------------------------------------------------------------------


def function_call(
    body: BodyContext, raw: syntax.Call, place: Span, functions: Sequence[Function], operands: list[tree.Expr]
) -> tree.Expr:
    """`square(x)`: the overload that fits."""
    candidates = [
        OverloadCandidate(candidate.head.name, tuple(p.type for p in candidate.head.parameters), candidate)
        for candidate in functions
    ]
    chosen = choose_overload(body.symbols, place, candidates, operands)
    if chosen is None:
        return unknown(raw.span)
    function, arguments = chosen
    method = _function_method(body, function)
    return tree.Call(raw.span, method.result, body.this(raw.span), method, arguments)


def _function_method(body: BodyContext, function: Function) -> tree.Method:
    """The method of the unit for the function; in the function itself, its head."""
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
