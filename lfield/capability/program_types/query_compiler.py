"""Queries of a program with parameters: found, checked, and translated to their compiled form.

payload >= $mass[g] && agent != $name      in L
payload >= $n0 && agent != $t1             compiled, with the values mass * 0.001 and name
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import cast

from lfield.capability.condition_parser import ParsedQuery, parse_query
from lfield.capability.condition_tree import (
    PARAMETER_SORTS,
    ConditionBinary,
    ConditionCall,
    ConditionExpr,
    ConditionLiteral,
    ConditionParameter,
    ConditionUnary,
    Mistake,
)
from lfield.capability.matching.condition_checker import NameScope, Sort, check_expression
from lfield.capability.model import Attribute, Expression
from lfield.capability.parameter_units import Conversion
from lfield.capability.query_values import parameters
from lfield.lang.capability_port import (
    CompiledQuery,
    Placeholder,
    PlaceholderSort,
    PlaceholderValue,
    QueryPlaceholders,
)

_QUOTED = re.compile(r"\$([A-Za-z_]\w*)", re.ASCII)
_LETTERS = {sort: letter for letter, sort in PARAMETER_SORTS.items()}
_SAME: Conversion = (1.0, 0.0)


def read_placeholders(text: str) -> QueryPlaceholders:
    """The placeholders of a query, and those that are within quotes by mistake."""
    parsed, mistakes = parse_query(text, parameters=True)
    if parsed is None:
        return QueryPlaceholders(mistakes=tuple(mistakes))
    found = [parameter for tree in _trees(parsed) for parameter in parameters(tree)]
    places = tuple(Placeholder(each.path, each.span.start, each.span.end) for each in found)
    quoted = tuple(
        Placeholder(match[1], literal.span.start, literal.span.end)
        for tree in _trees(parsed)
        for literal in _texts(tree)
        for match in _QUOTED.finditer(str(literal.value))
    )
    return QueryPlaceholders(places, quoted)


def numbered_query(
    text: str, sorts: Mapping[str, PlaceholderSort], attributes: Mapping[str, Attribute]
) -> CompiledQuery:
    """The query with numbered parameters, and the values that they need; or the mistakes."""
    parsed, mistakes = parse_query(text, parameters=True)
    if parsed is None:
        return CompiledQuery(mistakes=tuple(mistakes))
    offer = NameScope.of_offer(attributes)
    scope = NameScope(offer.names, parameters=cast(Mapping[str, Sort], sorts))
    conversions: dict[ConditionParameter, Conversion] = {}
    found = list[Mistake]()
    if parsed.condition is not None:
        found += check_expression(Expression(text, parsed.condition), scope, "boolean", conversions)
    for tree, _ in parsed.order:
        found += check_expression(Expression(text, tree), scope, "number", conversions)
    if found or "nothing" in sorts.values():
        return CompiledQuery(mistakes=tuple(found))
    return _numbered(text, parsed, sorts, conversions)


def _numbered(
    text: str,
    parsed: ParsedQuery,
    sorts: Mapping[str, PlaceholderSort],
    conversions: Mapping[ConditionParameter, Conversion],
) -> CompiledQuery:
    """The text with `$n0` for the first value; equal values have one number."""
    found = sorted(
        (p for tree in _trees(parsed) for p in parameters(tree)), key=lambda parameter: parameter.span.start
    )
    values: list[PlaceholderValue] = []
    numbered, at = "", 0
    for parameter in found:
        value = PlaceholderValue(parameter.path, *conversions.get(parameter, _SAME))
        if value not in values:
            values.append(value)
        numbered += (
            f"{text[at : parameter.span.start]}${_LETTERS[sorts[parameter.path]]}{values.index(value)}"
        )
        at = parameter.span.end
    return CompiledQuery(numbered + text[at:], tuple(values))


def _trees(parsed: ParsedQuery) -> Iterator[ConditionExpr]:
    if parsed.condition is not None:
        yield parsed.condition
    yield from (tree for tree, _ in parsed.order)


def _texts(tree: ConditionExpr) -> Iterator[ConditionLiteral]:
    """The text literals in a tree."""
    match tree:
        case ConditionLiteral(value=str()):
            yield tree
        case ConditionUnary(operand=operand):
            yield from _texts(operand)
        case ConditionBinary(left=left, right=right):
            yield from _texts(left)
            yield from _texts(right)
        case ConditionCall(arguments=arguments):
            for argument in arguments:
                yield from _texts(argument)
