"""Evaluates expressions over attributes: compiled once into closures, called for every offer.

Facts are flat: values by attribute (`payload`), or by part and attribute (`grip.payload`). A missing or
outdated fact has the value None: unknown. Logic is Kleene's three-valued logic: an unknown side makes `&&`
and `||` unknown unless the other side decides. Arithmetic is in reals; an undefined result (a division by 0)
is unknown.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from lfield.capability import condition_tree
from lfield.capability.matching.condition_checker import POSITION
from lfield.capability.model import Expression, Value
from lfield.capability.offer import Position

_NORTH, _EAST, _DOWN = POSITION

Facts = Mapping[str, Value]
Judge = Callable[[Facts], Value | None]


def same(left: Value, right: Value) -> bool:
    """Equality; of sets, whether they have a member in common, where a text is a set of one."""
    if isinstance(left, frozenset):
        return not left.isdisjoint(right if isinstance(right, frozenset) else (right,))
    return left in right if isinstance(right, frozenset) else left == right


def differ(left: Value, right: Value) -> bool:
    """The opposite of `same`."""
    return not same(left, right)


_COMPARISONS: Mapping[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": same,
    "!=": differ,
}
_ARITHMETIC: Mapping[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
_FUNCTIONS: Mapping[str, Callable[..., float]] = {"min": min, "max": max, "abs": abs}


@lru_cache(maxsize=4096)
def conjuncts(expression: Expression) -> tuple[Expression, ...]:
    """The operands of the top-level `&&`, in order: all of them must be true."""
    return tuple(Expression(tree.span.text, tree) for tree in _conjoined(expression.tree))


def _conjoined(tree: condition_tree.ConditionExpr) -> Iterator[condition_tree.ConditionExpr]:
    if isinstance(tree, condition_tree.ConditionBinary) and tree.operator == "&&":
        yield from _conjoined(tree.left)
        yield from _conjoined(tree.right)
    else:
        yield tree


@lru_cache(maxsize=4096)
def fact_names(expression: Expression) -> tuple[str, ...]:
    """The facts in an expression, each once, in the order of the text."""
    return tuple(dict.fromkeys(facts_of(expression.tree)))


def facts_of(tree: condition_tree.ConditionExpr) -> Iterator[str]:
    """The facts in a part of an expression."""
    match tree:
        case condition_tree.ConditionName() | condition_tree.ConditionMember():
            yield fact_name(tree)
        case condition_tree.ConditionUnary(operand=operand):
            yield from facts_of(operand)
        case condition_tree.ConditionBinary(left=left, right=right):
            yield from facts_of(left)
            yield from facts_of(right)
        case condition_tree.ConditionCall(arguments=arguments) if is_between_parts(tree):
            yield from (f"{fact_name(part)}.{axis}" for part in arguments for axis in POSITION)
        case condition_tree.ConditionCall(arguments=arguments) if function(tree) == "distance":
            yield from POSITION[: len(arguments)]
            for argument in arguments:
                yield from facts_of(argument)
        case condition_tree.ConditionCall(arguments=arguments):
            for argument in arguments:
                yield from facts_of(argument)


def fact_name(tree: condition_tree.ConditionExpr) -> str:
    """The name of the fact that a Name or a Member refers to."""
    match tree:
        case condition_tree.ConditionName(name=name):
            return name
        case condition_tree.ConditionMember(object=condition_tree.ConditionName(name=need), name=name):
            return f"{need}.{name}"
        case _:
            raise _unchecked(tree)


def is_between_parts(tree: condition_tree.ConditionCall) -> bool:
    """Whether a call is `distance(part, part)`; any other `distance` is to a place, written in numbers."""
    return function(tree) == "distance" and all(
        isinstance(a, condition_tree.ConditionName) for a in tree.arguments
    )


def function(tree: condition_tree.ConditionCall) -> str:
    """The name of the function that is called."""
    return tree.function.name


@lru_cache(maxsize=4096)
def evaluator(expression: Expression) -> Judge:
    """A function from facts to the value of the checked expression; None when it is unknown."""
    return value_of(expression.tree)


def value_of(tree: condition_tree.ConditionExpr) -> Judge:
    """The same function for a part of an expression."""
    match tree:
        case condition_tree.ConditionLiteral(value=value):
            return lambda facts: value
        case condition_tree.ConditionName() | condition_tree.ConditionMember():
            name = fact_name(tree)
            return lambda facts: facts.get(name)
        case condition_tree.ConditionUnary(operator="!", operand=operand):
            return _not(value_of(operand))
        case condition_tree.ConditionUnary(operand=operand):
            return _applied(operator.neg, [value_of(operand)])
        case condition_tree.ConditionBinary():
            return _binary(tree)
        case condition_tree.ConditionCall(arguments=arguments) if is_between_parts(tree):
            return _distance(fact_name(arguments[0]), fact_name(arguments[1]))
        case condition_tree.ConditionCall(arguments=arguments) if function(tree) == "distance":
            return _distance_to([value_of(argument) for argument in arguments])
        case condition_tree.ConditionCall(arguments=arguments):
            return _applied(_FUNCTIONS[function(tree)], [value_of(argument) for argument in arguments])
        case _:
            raise _unchecked(tree)


def _unchecked(tree: condition_tree.ConditionExpr) -> ValueError:
    return ValueError(f"this expression was not checked: {tree.span.text}")


# --- logic --------------------------------------------------------------------------------------------


def _binary(tree: condition_tree.ConditionBinary) -> Judge:
    sign = tree.operator
    if sign in _COMPARISONS:
        return _comparison(_COMPARISONS[sign], tree.left, tree.right)
    left, right = value_of(tree.left), value_of(tree.right)
    match sign:
        case "&&":
            return _and(left, right)
        case "||":
            return _not(_and(_not(left), _not(right)))
        case _:
            return _calculated(_ARITHMETIC[sign], left, right)


def _and(left: Judge, right: Judge) -> Judge:
    def judge(facts: Facts) -> bool | None:
        first = left(facts)
        if first is False:
            return False
        second = right(facts)
        if second is False:
            return False
        return None if first is None or second is None else True

    return judge


def _not(operand: Judge) -> Judge:
    def judge(facts: Facts) -> bool | None:
        value = operand(facts)
        return None if value is None else not value

    return judge


# --- values -------------------------------------------------------------------------------------------


def _comparison(
    compare: Callable[[Any, Any], bool],
    left: condition_tree.ConditionExpr,
    right: condition_tree.ConditionExpr,
) -> Judge:
    if isinstance(left, condition_tree.ConditionName | condition_tree.ConditionMember) and isinstance(
        right, condition_tree.ConditionLiteral
    ):
        return _compared_with(compare, fact_name(left), right.value)
    return _applied(compare, [value_of(left), value_of(right)])


def _compared_with(compare: Callable[[Any, Any], bool], name: str, constant: object) -> Judge:
    """A comparison, specialised because a thousand offers are evaluated by it."""

    def judge(facts: Facts) -> bool | None:
        value = facts.get(name)
        return None if value is None else compare(value, constant)

    return judge


def _applied(call: Callable[..., Value], operands: list[Judge]) -> Judge:
    def judge(facts: Facts) -> Value | None:
        values = [operand(facts) for operand in operands]
        return None if None in values else call(*values)

    return judge


def _calculated(calculate: Callable[[float, float], float], left: Judge, right: Judge) -> Judge:
    def judge(facts: Facts) -> float | None:
        first, second = left(facts), right(facts)
        if first is None or second is None:
            return None
        try:
            result = calculate(_real(first), _real(second))
        except ZeroDivisionError:
            return None
        return result if math.isfinite(result) else None

    return judge


def _real(value: Value) -> float:
    assert isinstance(value, int | float)
    return float(value)


def _distance(point: str, other: str) -> Judge:
    axes = [(f"{point}.{axis}", f"{other}.{axis}") for axis in POSITION]

    def judge(facts: Facts) -> float | None:
        squares = 0.0
        for own, target in axes:
            first, second = facts.get(own), facts.get(target)
            if first is None or second is None:
                return None
            apart = _real(first) - _real(second)
            squares += apart * apart
        return _root(squares)

    return judge


def _distance_to(place: list[Judge]) -> Judge:
    """The distance from an offer to a place: north, east and, if three are given, down."""

    def judge(facts: Facts) -> float | None:
        squares = 0.0
        for axis, target_of in zip(POSITION, place, strict=False):
            is_at, target = facts.get(axis), target_of(facts)
            if is_at is None or target is None:
                return None
            apart = _real(is_at) - _real(target)
            squares += apart * apart
        return _root(squares)

    return judge


def distance_to(facts: Mapping[str, Any], place: Position) -> float | None:
    """Metres from an offer to a place, horizontal if one of the two has no depth.

    None if a position is unknown.
    """
    north, east, down = facts.get(_NORTH), facts.get(_EAST), facts.get(_DOWN)
    if north is None or east is None:
        return None
    there_north, there_east, there_down = place
    x, y = north - there_north, east - there_east
    z = 0.0 if down is None or there_down is None else down - there_down
    return _root(x * x + y * y + z * z)


def _root(squares: float) -> float | None:
    """Metres from their squares; None if the result is no finite number."""
    return math.sqrt(squares) if squares < math.inf else None
