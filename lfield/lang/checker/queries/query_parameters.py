"""Values of the program in a query: `findLift("payload >= $kg && agent != $name")`.

A name after `$` is a variable, a field or a constant, with fields and elements after it. Its type determines
its sort in the query. The call gets the query, with numbers for the names, and the values after it
in one string (lfield/capability/query_values.py), a sum of texts like any other.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

from msgspec.structs import replace

from lfield.lang import messages, syntax, tree
from lfield.lang.capability_port import CapabilityTypes, PlaceholderSort, PlaceholderValue
from lfield.lang.checker.conversions import require_type, unknown, with_article
from lfield.lang.checker.library.collection_calls import map_element
from lfield.lang.checker.library.enum_members import member_name
from lfield.lang.checker.name_resolution import check_member, check_variable
from lfield.lang.checker.queries.query_text import QueryText
from lfield.lang.checker.scope import BodyContext
from lfield.lang.parser.expressions import expression
from lfield.lang.parser.token_stream import TokenStream
from lfield.lang.scanner import scan
from lfield.lang.types import BOOLEAN, INT, REAL, STRING, UNKNOWN, ArrayType, EnumType, MapType, Type
from lfield.text.source_text import Diagnostics, Source, Span

#: Between the query and its values (capability/query_values.py).
_SEPARATOR = "\0"
#: A key of a map, or the sign before a name.
_QUOTED_OR_SIGN = re.compile(r'("(?:[^"\\]|\\.)*")|\$')
_SORTS: Mapping[Type, PlaceholderSort] = {
    INT: "number",
    REAL: "number",
    STRING: "text",
    BOOLEAN: "boolean",
}


def with_parameters(body: BodyContext, raw: syntax.Call, query: QueryText) -> tree.Expr | None:
    """The argument of a query whose text has placeholders; None if it has none."""
    types = body.symbols.capabilities
    assert types is not None
    read = types.placeholders(query.text)
    for problem in read.mistakes:
        place = query.place(problem.start, problem.end)
        body.report(messages.CONSTRAINT, place, hint=problem.hint, problem=problem.message)
    for placeholder in read.quoted:
        if is_variable(body, placeholder.path):
            body.report(
                messages.QUOTED_PARAMETER,
                query.place(placeholder.start, placeholder.end),
                name=placeholder.path,
            )
    if read.mistakes:
        return unknown(raw.span)
    if not read.placeholders:
        return None
    values = {
        placeholder.path: _value(body, placeholder.path, query.place(placeholder.start, placeholder.end))
        for placeholder in read.placeholders
    }
    sorts = {path: _sort(body, value) for path, value in values.items()}
    return _compiled(body, raw, query, values, sorts, types)


def _compiled(
    body: BodyContext,
    raw: syntax.Call,
    query: QueryText,
    values: Mapping[str, tree.Expr],
    sorts: Mapping[str, PlaceholderSort],
    types: CapabilityTypes,
) -> tree.Expr:
    compiled = types.compile_query(query.text, sorts)
    for problem in compiled.mistakes:
        place = query.place(problem.start, problem.end)
        body.report(messages.CONSTRAINT, place, hint=problem.hint, problem=problem.message)
    if compiled.mistakes or "nothing" in sorts.values():
        return unknown(raw.span)
    span = query.pieces[0][1].span.to(query.pieces[-1][1].span)
    parts: list[str | tree.Expr] = [compiled.text + _SEPARATOR]
    for value in compiled.values:
        parts += _encoded(body, raw, values[value.path], value)
    return _joined(span, parts)


def is_variable(body: BodyContext, name: str) -> bool:
    """Whether a name is a variable, a field or a constant here."""
    known = body.scope.find(name) is not None or body.field(name) is not None
    return known or name in body.symbols.constants


# --- values -------------------------------------------------------------------------------------------------


def _value(body: BodyContext, path: str, place: Span) -> tree.Expr:
    """The value of a path such as `$at[$i].north`; all of it has one place."""
    discarded = Diagnostics()
    without_signs = _QUOTED_OR_SIGN.sub(lambda found: found[1] or "", path)
    raw = expression(TokenStream(scan(Source("", without_signs), discarded), discarded))
    return _part(body, raw, place)


def _part(body: BodyContext, raw: syntax.Expr, place: Span) -> tree.Expr:
    match raw:
        case syntax.Name():
            return check_variable(body, replace(raw, span=place))
        case syntax.Literal_(value=value):
            return tree.Literal_(place, INT if isinstance(value, int) else STRING, value)
        case syntax.Member():
            return check_member(body, replace(raw, span=place, place=place), _part(body, raw.object, place))
        case syntax.Index():
            return _element(body, raw, place)
    return unknown(place)


def _element(body: BodyContext, raw: syntax.Index, place: Span) -> tree.Expr:
    array, index = _part(body, raw.array, place), _part(body, raw.index, place)
    if isinstance(array.type, MapType):
        return map_element(body, replace(raw, span=place), array, index)
    index = require_type(body.symbols, index, INT)
    if isinstance(array.type, ArrayType):
        return tree.Element(place, array.type.element, array, index)
    if array.type is not UNKNOWN:
        body.report(messages.NOT_AN_ARRAY, place, given=with_article(array.type))
    return unknown(place)


def _sort(body: BodyContext, value: tree.Expr) -> PlaceholderSort:
    """The sort of a value in a query; 'nothing' if it cannot be in one, which is reported."""
    if isinstance(value.type, EnumType):
        return "text"
    if value.type not in _SORTS and value.type is not UNKNOWN:
        body.report(messages.PARAMETER_TYPE, value.span, given=with_article(value.type))
    return _SORTS.get(value.type, "nothing")


# --- the string that the call gets --------------------------------------------------------------------------


def _encoded(
    body: BodyContext, raw: syntax.Call, value: tree.Expr, placeholder: PlaceholderValue
) -> Iterator[str | tree.Expr]:
    """The parts of the string for one value."""
    span, name = value.span, f" {placeholder.path}{_SEPARATOR}"
    if value.type == BOOLEAN:
        yield from ("b", tree.LibraryCall(span, STRING, "b2s", [value]), name)
    elif value.type in (INT, REAL):
        number = _converted(value, placeholder)
        to_text = "i2s" if number.type == INT else "f2s"
        yield from ("n", tree.LibraryCall(span, STRING, to_text, [number]), name)
    else:
        text = member_name(body, raw, value) if isinstance(value.type, EnumType) else value
        length = tree.LibraryCall(span, INT, "str_len", [text])
        yield from ("t", tree.LibraryCall(span, STRING, "i2s", [length]), name, text)


def _converted(value: tree.Expr, placeholder: PlaceholderValue) -> tree.Expr:
    """A number in the unit of the other side of the comparison."""
    if (placeholder.factor, placeholder.offset) == (1.0, 0.0):
        return value
    span = value.span
    real = tree.ToReal(span, REAL, value) if value.type == INT else value
    scaled = tree.Binary(span, REAL, "*", real, tree.Literal_(span, REAL, placeholder.factor))
    return (
        tree.Binary(span, REAL, "+", scaled, tree.Literal_(span, REAL, placeholder.offset))
        if placeholder.offset
        else scaled
    )


def _joined(span: Span, parts: list[str | tree.Expr]) -> tree.Expr:
    """The sum of some texts, the first of which stays a constant of its own."""
    first, *others = parts
    assert isinstance(first, str)
    joined: tree.Expr = tree.Literal_(span, STRING, first)
    pending = ""
    for part in (*others, None):
        if isinstance(part, str):
            pending += part
            continue
        if pending:
            joined = tree.Binary(span, STRING, "+", joined, tree.Literal_(span, STRING, pending))
            pending = ""
        if part is not None:
            joined = tree.Binary(span, STRING, "+", joined, part)
    return joined
