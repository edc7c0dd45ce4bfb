"""`async call`, and the methods of arrays of futures: `race` and `next` (decision 102)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator

from lfield.lang import messages, syntax, tree
from lfield.lang.capability_port import is_portal
from lfield.lang.checker.conversions import unknown
from lfield.lang.checker.library.collection_calls import call_of_text
from lfield.lang.checker.scope import BodyContext
from lfield.lang.checker.symbols import Symbols, describe
from lfield.lang.standard_library.instances import FUTURE_CONSTRUCTOR, array_texts
from lfield.lang.tree_traversal import all_statements, descendants, statement_expressions
from lfield.lang.types import BOOLEAN, EXCEPTION, INT, UNKNOWN, VOID, ArrayType, FutureType, future_of
from lfield.text.suggestions import listed

_AT_MOST = "at most one argument, the name of a method"
_REFUSES = re.compile(r"REFUSES\((open\[first\])\)")
#: The methods of arrays of futures, and those that only the library calls: result and instruction.
_METHODS = {"next": (INT, "next")}
_INTERNAL = {"cancel": (VOID, "cancel"), "thrown": (EXCEPTION, "failure")}


def check_async(body: BodyContext, raw: syntax.Async, call: tree.Expr) -> tree.Expr:
    """`async arm.lift(1.0)`: the call begins, the value is its future."""
    if body.unit.usage != "coordinator":
        body.report(messages.ASYNC_PLACE, raw.keyword, viewer=describe(body.unit))
    elif call.type is not UNKNOWN:
        if isinstance(call, tree.PortalCall) or (isinstance(call, tree.Call) and is_portal(call.method)):
            kind = future_of(call.type)
            constructor = body.symbols.library_class(kind).overloads(FUTURE_CONSTRUCTOR, "constructor")[0]
            return tree.Async(raw.span, kind, call, constructor)
        body.report(messages.ASYNC_CALL, raw.call.span)
    return unknown(raw.span)


def is_future_method(body: BodyContext, name: str, owner: tree.Expr) -> bool:
    """Whether a name is a method of arrays of futures in this body."""
    if not (isinstance(owner.type, ArrayType) and isinstance(owner.type.element, FutureType)):
        return False
    internal = name in _INTERNAL and bool(body.symbols.library.parameters)
    return name == "race" or name in _METHODS or internal


def check_future_method(body: BodyContext, raw: syntax.Call, owner: tree.Expr) -> tree.Expr:
    """`futures.next()`, `futures.race()` or `futures.race(method)`."""
    assert isinstance(owner.type, ArrayType)
    assert isinstance(owner.type.element, FutureType)
    assert isinstance(raw.function, syntax.Member)
    name = raw.function.name
    if isinstance(owner, tree.Elements | tree.NewArray) and _is_empty(owner):
        body.report(messages.RACE_EMPTY, owner.span, name=name)
        return unknown(raw.span)
    if name == "race":
        return _race(body, raw, owner, owner.type.element)
    if raw.arguments:
        body.report(messages.RACE_ARGUMENT, raw.arguments[0].span, name=name, argument="no argument")
        return unknown(raw.span)
    result, operation = {**_METHODS, **_INTERNAL}[name]
    return tree.LibraryCall(raw.span, result, operation, [owner])


def _race(body: BodyContext, raw: syntax.Call, owner: tree.Expr, kind: FutureType) -> tree.Expr:
    text = array_texts()["race"]
    if not raw.arguments:
        return call_of_text(body, raw, "race", _REFUSES.sub(r"\1.failed()", text), owner, INT)
    argument = raw.arguments[0]
    if kind.value == VOID:
        body.report(
            messages.RACE_ARGUMENT,
            argument.span,
            name="race",
            argument="no argument for futures without results",
        )
        return unknown(raw.span)
    if len(raw.arguments) > 1 or not isinstance(argument, syntax.Name):
        body.report(
            messages.RACE_ARGUMENT,
            raw.arguments[-1].span,
            name="race",
            argument="at most one argument, the name of a method",
        )
        return unknown(raw.span)
    name = argument.name
    methods = body.methods(name) or [function.head for function in body.symbols.functions.get(name, ())]
    for method in methods:
        if [p.type for p in method.parameters] == [kind.value] and method.result == BOOLEAN:
            accepts = rf"(\1.failed() || !{name}(\1.await()))"
            return call_of_text(body, raw, "race", _REFUSES.sub(accepts, text), owner, INT)
    if not body.is_broken():
        known = [method.signature for method in methods]
        found = f"'{name}' is {listed(known)}" if known else f"there is no method or function '{name}' here"
        body.report(messages.RACE_METHOD, argument.span, found=found, of=kind.value, name=name)
    return unknown(raw.span)


def _is_empty(array: tree.Elements | tree.NewArray) -> bool:
    """Whether an array has no elements, by its text."""
    if isinstance(array, tree.Elements):
        return not array.elements
    length = array.lengths[0]
    return isinstance(length, tree.Literal_) and length.value == 0


def check_futures(symbols: Symbols, body: list[tree.Stmt]) -> None:
    """Report races of arrays that are empty, and futures that are twice in one array, in a method."""
    for part in _expressions(body):
        match part:
            case tree.Elements(type=ArrayType(element=FutureType())):
                _check_twice(symbols, part)
    for empty in _empty_arrays(body):
        symbols.report(messages.RACE_EMPTY, empty.span, name="race")


def _check_twice(symbols: Symbols, array: tree.Elements) -> None:
    first: dict[tree.Local | tree.Field, int] = {}
    for element in array.elements:
        match element:
            case tree.LocalGet(local=named):
                pass
            case tree.FieldGet(object=tree.This(), field=named):
                pass
            case _:
                continue
        if named in first:
            symbols.report(messages.FUTURE_TWICE, element.span, name=named.name)
        first[named] = element.span.line


def _empty_arrays(body: list[tree.Stmt]) -> Iterator[tree.Expr]:
    """The arrays on which `race` is called, in locals that are declared empty and never changed."""
    empty = [
        stmt.local
        for stmt in all_statements(body)
        if isinstance(stmt, tree.Declare)
        and isinstance(stmt.value, tree.Elements | tree.NewArray)
        and _is_empty(stmt.value)
        and isinstance(stmt.local.type, ArrayType)
        and isinstance(stmt.local.type.element, FutureType)
    ]
    if not empty:
        return
    uses: Counter[tree.Local] = Counter()
    raced: dict[tree.Local, list[tree.Expr]] = {}
    for part in _expressions(body):
        match part:
            case tree.Call(method=tree.Method(name="race"), arguments=[tree.LocalGet() as of]):
                raced.setdefault(of.local, []).append(of)
            case tree.LocalGet():
                uses[part.local] += 1
    for local in empty:
        if len(raced.get(local, [])) == uses[local]:
            yield from raced.get(local, [])


def _expressions(body: list[tree.Stmt]) -> Iterator[tree.Expr]:
    for stmt in all_statements(body):
        for value in statement_expressions(stmt):
            yield from descendants(value)
