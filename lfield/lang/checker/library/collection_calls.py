"""Calls of the library that is written in L: methods of arrays (`arrays.L`), and of maps (`map.L`).

`a.sort()` becomes a call of a private method of the unit that contains the call, one for each type of
elements. So a comparison is a call of a method of that unit, which the checker selects as usual. Elements of
maps are calls of methods of the class of the map.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from lfield.lang import messages, syntax, tree
from lfield.lang.checker.conversions import (
    OverloadCandidate,
    choose_overload,
    require_type,
    unknown,
    with_article,
)
from lfield.lang.checker.library.unit_methods import text_call
from lfield.lang.checker.scope import BodyContext
from lfield.lang.standard_library.instances import array_texts
from lfield.lang.types import BOOLEAN, INT, REAL, STRING, UNKNOWN, VOID, ArrayType, MapType, Type, array_of
from lfield.text.source_text import Span
from lfield.text.suggestions import listed

_CALL = re.compile(r"BEFORE\((\w+), (\w+)\)")
#: Whether one key is before another, by type. A real that is NaN is after all others.
_NATURAL = {
    INT: r"(\1 < \2)",
    STRING: r"(\1 < \2)",
    REAL: r"(\1 < \2 || (\2 != \2 && \1 == \1))",
}


def check_library_call(
    body: BodyContext, raw: syntax.Call, owner: tree.Expr, arguments: list[tree.Expr]
) -> tree.Expr:
    """`array.contains(x)`, `array.indexOf(x)` or `array.slice(from, to)`."""
    assert isinstance(owner.type, ArrayType)
    name, place = raw.function.name, _place(raw)
    parameters = (INT, INT) if name == "slice" else (owner.type.element,)
    result = {"contains": BOOLEAN, "indexOf": INT}.get(name, owner.type)
    chosen = choose_overload(body.symbols, place, [OverloadCandidate(name, parameters, name)], arguments)
    if chosen is None:
        return unknown(raw.span)
    return _call(body, raw, name, array_texts()[name], (owner, *chosen[1]), result)


def check_sort(body: BodyContext, raw: syntax.Call, owner: tree.Expr) -> tree.Expr:
    """`array.sort()`, or `array.sort(method)` with a method of this unit that returns a key or compares."""
    assert isinstance(owner.type, ArrayType)
    element_type, arguments = owner.type.element, raw.arguments
    if not arguments:
        if element_type not in _NATURAL:
            body.report(
                messages.SORT_ORDER, _place(raw), type=with_article(element_type), element=element_type
            )
            return unknown(raw.span)
        return _call(body, raw, "sort", _natural("sort", element_type), (owner,), VOID)
    if len(arguments) > 1 or not isinstance(arguments[0], syntax.Name):
        body.report(messages.SORT_ARGUMENT, arguments[-1].span)
        return unknown(raw.span)
    name = arguments[0].name
    functions = [function.head for function in body.symbols.functions.get(name, ())]
    for method in body.methods(name) or functions:
        types = [parameter.type for parameter in method.parameters]
        if types == [element_type] and method.result in _NATURAL:
            text = _natural("sortByKey", method.result).replace("KEY(", f"{name}(")
            return _call(body, raw, "sortByKey", text, (owner,), VOID, method.result)
        if types == [element_type, element_type] and method.result == BOOLEAN:
            text = _CALL.sub(rf"{name}(\1, \2)", array_texts()["sort"])
            return _call(body, raw, "sort", text, (owner,), VOID)
    if not body.is_broken() and element_type is not UNKNOWN:
        known = [method.signature for method in body.methods(name) or functions]
        found = f"'{name}' is {listed(known)}" if known else f"there is no method or function '{name}' here"
        body.report(messages.SORT_METHOD, arguments[0].span, found=found, element=element_type, name=name)
    return unknown(raw.span)


def call_of_text(
    body: BodyContext, raw: syntax.Call, name: str, text: str, array: tree.Expr, result: Type
) -> tree.Expr:
    """The call of a method with this text, of an array without other arguments."""
    return _call(body, raw, name, text, (array,), result)


def _place(raw: syntax.Call) -> Span:
    assert isinstance(raw.function, syntax.Member)
    return raw.function.place


def _natural(name: str, element_type: Type) -> str:
    """The text of a method that compares values of a type."""
    return _CALL.sub(_NATURAL[element_type], array_texts()[name])


def _call(
    body: BodyContext,
    raw: syntax.Call,
    name: str,
    text: str,
    arguments: Sequence[tree.Expr],
    result: Type,
    key: Type = VOID,
) -> tree.Expr:
    """The call of the instance of a method whose first parameter is the array."""
    array = arguments[0].type
    assert isinstance(array, ArrayType)
    types = {"T": array.element, "K": key}
    return text_call(body, raw, name, text, types, arguments, result)


# --- maps ---------------------------------------------------------------------------------------------


def map_element(body: BodyContext, raw: syntax.Index, found: tree.Expr, index: tree.Expr) -> tree.Call:
    """`m[key]`: the value of a key; IndexException without one."""
    assert isinstance(found.type, MapType)
    key = require_type(body.symbols, index, found.type.key)
    return _map_call(body, raw.span, found, "get", [key])


def assigned_element(raw: syntax.Expr, found: tree.Expr) -> tree.Call | None:
    """The call of an element of a map where an assignment has it on its left; None for anything else."""
    if isinstance(raw, syntax.Index) and isinstance(found, tree.Call):
        return found if isinstance(found.object.type, MapType) else None
    return None


def set_element(body: BodyContext, span: Span, element: tree.Call, value: tree.Expr) -> tree.Call:
    """`m[key] = value`."""
    return _map_call(body, span, element.object, "set", [*element.arguments, value])


def map_keys(body: BodyContext, found: tree.Expr) -> tree.Expr:
    """The keys of a map, in the order of their insertion, as an array."""
    assert isinstance(found.type, MapType)
    call = _map_call(body, found.span, found, "keys", [])
    assert call.type == array_of(found.type.key)
    return call


def _map_call(
    body: BodyContext, span: Span, found: tree.Expr, name: str, arguments: list[tree.Expr]
) -> tree.Call:
    unit = body.symbols.units[found.type.name]
    method = unit.overloads(name, "method")[0]
    return tree.Call(span, method.result, found, method, arguments)
