"""Queries with parameters: the text of the query, known to the compiler, and the values of one call.

    payload >= $n0 && agent != $t1        the text; the letter is the sort of a value: number, text, boolean
    n2.5 kg|t5 name|bob"s                 the values; after each, or after the length of a text, its name

`|` stands for SEPARATOR.

A program passes both in one string, with SEPARATOR between them. The values are bound to the parsed text.
They are never parsed as a condition, so no text in them can change the query.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence

from msgspec.structs import replace

from lfield.capability.condition_tree import (
    ConditionBinary,
    ConditionCall,
    ConditionExpr,
    ConditionLiteral,
    ConditionMember,
    ConditionName,
    ConditionParameter,
    ConditionUnary,
)
from lfield.capability.model import Expression, OfferQuery, SortKey
from lfield.errors import ConstraintError
from lfield.text.source_text import Source, Span

#: The character between a text and its values: no condition can contain it.
SEPARATOR = "\0"

Bindable = bool | int | float | str
_PLAIN = re.compile(r"([nb])([^ ]*) ([^\0]*)\0")
_TEXT = re.compile(r"t(\d{1,9}) ([^\0]*)\0")
_PARAMETER = re.compile(r"\$[nbt](\d+)")
_BOOLEANS = {"true": True, "false": False}


def split_values(constraint: str) -> tuple[str, list[Bindable] | None]:
    """The text of a query with its SEPARATOR, and the values; None without a SEPARATOR.

    Raises ConstraintError for malformed values.
    """
    text, separator, encoded = constraint.partition(SEPARATOR)
    return text + separator, _values(text, encoded) if separator else None


def _values(text: str, encoded: str) -> list[Bindable]:
    literals: list[tuple[str, str, str]] = []
    at = 0
    while at < len(encoded):
        if match := _PLAIN.match(encoded, at):
            sort, written, name = match.groups()
            at = match.end()
        elif match := _TEXT.match(encoded, at):
            sort, name, start = "t", match[2], match.end()
            at = start + int(match[1])
            written = encoded[start:at]
        else:
            at = len(encoded) + 1
        if at > len(encoded):
            raise ConstraintError(text, ["its values are malformed"])
        literals.append((sort, written, name))
    try:
        return [
            written if sort == "t" else _plain(text, sort, written, name) for sort, written, name in literals
        ]
    except ConstraintError as wrong:
        names = [name for _, _, name in literals]
        raise ConstraintError(_with_names(text, names), wrong.problems) from None


def _with_names(text: str, names: Sequence[str]) -> str:
    """The text of a query as it is written in the program."""
    known = {str(number): f"${name}" for number, name in enumerate(names)}
    return _PARAMETER.sub(lambda found: known.get(found[1], found[0]), text)


def _plain(text: str, sort: str, written: str, name: str) -> Bindable:
    if sort == "b" and written in _BOOLEANS:
        return _BOOLEANS[written]
    try:
        value = int(written) if written.lstrip("-").isdigit() else float(written)
    except ValueError:
        raise ConstraintError(text, ["its values are malformed"]) from None
    if sort != "n" or not math.isfinite(value):
        raise ConstraintError(text, [f"${name} is {written}, not a finite number"])
    return value


# --- binding ------------------------------------------------------------------------------------------------


def bind(query: OfferQuery, values: Sequence[Bindable]) -> OfferQuery:
    """The query with values for its parameters. Raises ConstraintError if they do not fit."""
    condition = None if query.condition is None else _bound(query.condition, values)
    order = tuple(SortKey(_bound(key.value, values), key.descending) for key in query.order)
    return replace(query, condition=condition, order=order)


def parameters(tree: ConditionExpr) -> Iterator[ConditionParameter]:
    """The parameters in a tree, from left to right."""
    match tree:
        case ConditionParameter():
            yield tree
        case ConditionUnary(operand=operand):
            yield from parameters(operand)
        case ConditionBinary(left=left, right=right):
            yield from parameters(left)
            yield from parameters(right)
        case ConditionMember(object=owner):
            yield from parameters(owner)
        case ConditionCall(arguments=arguments):
            for argument in arguments:
                yield from parameters(argument)


def standalone(tree: ConditionExpr) -> Expression:
    """An expression with places that count from its own start, not from that of the text around it."""
    source, start = Source("", tree.span.text), tree.span.start
    moved = _Moved(lambda span: Span(source, span.start - start, span.end - start), {})
    return Expression(source.text, moved.tree(tree))


def _bound(expression: Expression, values: Sequence[Bindable]) -> Expression:
    """The expression with literals for its parameters, in its text too: explanations show it."""
    found = sorted(parameters(expression.tree), key=lambda parameter: parameter.span.start)
    if not found:
        return expression
    values_by_parameter = {parameter: _value_of(expression, parameter, values) for parameter in found}
    text, at = "", 0
    ends: list[tuple[int, int]] = []
    for parameter in found:
        text += expression.text[at : parameter.span.start] + _literal_text(values_by_parameter[parameter])
        at = parameter.span.end
        ends.append((at, len(text)))
    source = Source("", text + expression.text[at:])

    def moved(span: Span) -> Span:
        return Span(source, _moved_place(span.start, ends), _moved_place(span.end, ends))

    return Expression(source.text, _Moved(moved, values_by_parameter).tree(expression.tree))


def _moved_place(place: int, ends: Sequence[tuple[int, int]]) -> int:
    """A place after the text of parameters that has another length now."""
    before = [(old, new) for old, new in ends if old <= place]
    old, new = before[-1] if before else (0, 0)
    return place - old + new


def _value_of(expression: Expression, parameter: ConditionParameter, values: Sequence[Bindable]) -> Bindable:
    number = int(parameter.path[1:])
    if number < len(values) and parameter.sort == sort_of(values[number]):
        return values[number]
    raise ConstraintError(expression.text, [f"the value of ${parameter.path} is missing or of another type"])


def sort_of(value: Bindable) -> str:
    """The sort of a value, as in the types of expressions."""
    if isinstance(value, bool):
        return "boolean"
    return "text" if isinstance(value, str) else "number"


def _literal_text(value: Bindable) -> str:
    return repr(value) if sort_of(value) == "number" else json.dumps(value, ensure_ascii=False)


class _Moved:
    """Copies trees to other places, with literals for their parameters."""

    def __init__(self, place: Callable[[Span], Span], values: Mapping[ConditionParameter, Bindable]) -> None:
        self._place, self._bound_values = place, values

    def tree(self, tree: ConditionExpr) -> ConditionExpr:
        """The copy of a checked tree."""
        span = self._place(tree.span)
        match tree:
            case ConditionParameter() if tree in self._bound_values:
                return ConditionLiteral(span, 1, self._bound_values[tree])
            case ConditionUnary(operand=operand):
                return replace(tree, span=span, operand=self.tree(operand))
            case ConditionBinary(sign=sign, left=left, right=right):
                left, right = self.tree(left), self.tree(right)
                return replace(tree, span=span, sign=self._place(sign), left=left, right=right)
            case ConditionMember(object=owner, place=place):
                return replace(tree, span=span, object=self.tree(owner), place=self._place(place))
            case ConditionCall(function=function, arguments=arguments):
                moved = self.tree(function)
                assert isinstance(moved, ConditionName | ConditionMember)
                return replace(tree, span=span, function=moved, arguments=list(map(self.tree, arguments)))
        return replace(tree, span=span)
