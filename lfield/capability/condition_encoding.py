"""The tree of a condition as plain data: its form in a bundle, so that a robot needs no parser.

A node is a list: its kind, the first character and the one after the last, then its own fields. Decoding
accepts data of any origin: kinds, types and places are checked, heights are computed and limited.
"""

from __future__ import annotations

import math

from lfield.capability.condition_tree import (
    MAX_HEIGHT,
    ConditionBinary,
    ConditionCall,
    ConditionExpr,
    ConditionLiteral,
    ConditionMember,
    ConditionName,
    ConditionParameter,
    ConditionUnary,
)
from lfield.text.source_text import Source, Span

#: The longest name of a parameter.
MAX_PARAMETER = 6
_UNARY_OPERATORS = ("!", "-")
_BINARY_OPERATORS = ("||", "&&", "==", "!=", "<", "<=", ">", ">=", "+", "-", "*", "/")


def encode_tree(tree: ConditionExpr) -> list[object]:
    """A checked tree as plain data."""
    place = [tree.span.start, tree.span.end]
    match tree:
        case ConditionLiteral(value=value):
            return ["literal", *place, value]
        case ConditionName(name=name):
            return ["name", *place, name]
        case ConditionParameter(path=path):
            return ["parameter", *place, path]
        case ConditionUnary(operator=operator, operand=operand):
            return ["unary", *place, operator, encode_tree(operand)]
        case ConditionBinary(operator=operator, sign=sign, left=left, right=right):
            return ["binary", *place, operator, sign.start, sign.end, encode_tree(left), encode_tree(right)]
        case ConditionMember(object=owner, name=name, place=named):
            return ["member", *place, encode_tree(owner), name, named.start, named.end]
        case ConditionCall(function=function, arguments=arguments):
            return ["call", *place, encode_tree(function), [encode_tree(argument) for argument in arguments]]
    raise TypeError(f"no checked condition has a {type(tree).__name__}")


def decode_tree(text: str, data: object) -> ConditionExpr:
    """The tree of the condition `text`. Raises ValueError for invalid data."""
    return _decode(Source("", text), data, 1)


def _decode(source: Source, data: object, depth: int) -> ConditionExpr:
    if depth > MAX_HEIGHT:
        raise ValueError(f"a condition is nested more than {MAX_HEIGHT} levels deep")
    match data:
        case [str(kind), start, end, *rest]:
            span = _span(source, start, end)
        case _:
            raise ValueError("a node of a condition is malformed")
    match kind, rest:
        case "literal", [bool() | int() | str() as value]:
            return ConditionLiteral(span, 1, value)
        case "literal", [float() as value] if math.isfinite(value):
            return ConditionLiteral(span, 1, value)
        case "name", [str(name)]:
            return ConditionName(span, 1, name)
        case "parameter", [str(path)] if (
            len(path) <= MAX_PARAMETER and (parameter := ConditionParameter(span, 1, path)).sort
        ):
            return parameter
        case "unary", [str(operator), operand] if operator in _UNARY_OPERATORS:
            inner = _decode(source, operand, depth + 1)
            return ConditionUnary(span, inner.height + 1, operator, inner)
        case "binary", [str(operator), first, last, left, right] if operator in _BINARY_OPERATORS:
            sides = _decode(source, left, depth + 1), _decode(source, right, depth + 1)
            height = 1 + max(side.height for side in sides)
            return ConditionBinary(span, height, operator, _span(source, first, last), *sides)
        case "member", [owner, str(name), first, last]:
            inner = _decode(source, owner, depth + 1)
            return ConditionMember(span, inner.height + 1, inner, name, _span(source, first, last))
        case "call", [function, list(arguments)]:
            decoded = [_decode(source, argument, depth + 1) for argument in arguments]
            return _call(span, _decode(source, function, depth + 1), decoded)
    raise ValueError("a node of a condition is malformed")


def _call(span: Span, function: ConditionExpr, arguments: list[ConditionExpr]) -> ConditionCall:
    if not isinstance(function, ConditionName | ConditionMember):
        raise ValueError("only a name can be called in a condition")
    height = 1 + max([function.height, *(argument.height for argument in arguments)])
    return ConditionCall(span, height, function, arguments)


def _span(source: Source, start: object, end: object) -> Span:
    if isinstance(start, int) and isinstance(end, int) and 0 <= start <= end <= len(source.text):
        return Span(source, start, end)
    raise ValueError("a place in a condition is outside of its text")
