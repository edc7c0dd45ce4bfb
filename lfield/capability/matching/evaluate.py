"""What expressions over attributes are worth, given facts; made once into closures, called for every offer.

Facts are flat: values by attribute (`payload`), or by part and attribute (`grip.payload`). What is not
stated, not known or too old is not in them, and its value is None: unknown. Logic is Kleene's: an unknown
side leaves `&&` and `||` unknown unless the other side decides. Arithmetic is in reals; a result that is
none (a division by 0) is unknown too.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from typing import Any

from lfield.capability.model import Expression, Tree, Value

#: The attributes from which `distance` is computed: metres from the team's common origin.
POSITION = ("north", "east", "down")

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
    """What its top-level `&&` join, in order: all of them must be true."""
    return tuple(Expression(tree.text, tree) for tree in _conjoined(expression.tree))


def _conjoined(tree: Tree) -> Iterator[Tree]:
    if tree.form == "&&":
        for side in tree.operands:
            yield from _conjoined(side)
    else:
        yield tree


@lru_cache(maxsize=4096)
def names(expression: Expression) -> tuple[str, ...]:
    """The facts that it looks at, each once, in the order of the text."""
    return tuple(dict.fromkeys(named(expression.tree)))


def named(tree: Tree) -> Iterator[str]:
    """The facts that a part of an expression looks at."""
    match tree.form:
        case "fact":
            yield tree.name
        case "part":
            yield from (f"{tree.name}.{axis}" for axis in POSITION)
        case _:
            for operand in tree.operands:
                yield from named(operand)


@lru_cache(maxsize=4096)
def evaluator(expression: Expression) -> Judge:
    """A function from facts to the value of the expression; None when it is unknown."""
    return value_of(expression.tree)


def value_of(tree: Tree) -> Judge:
    """The same for a part of an expression."""
    form, value, name = tree.form, tree.value, tree.name
    match form, tree.operands:
        case "constant", _:
            return lambda facts: value
        case "fact", _:
            return lambda facts: facts.get(name)
        case "distance", (one, other):
            return _distance(one.name, other.name)
        case _, (left, right) if form in _COMPARISONS:
            return _comparison(_COMPARISONS[form], left, right)
        case "!", (operand,):
            return _not(value_of(operand))
        case "-", (operand,):
            return _applied(operator.neg, [value_of(operand)])
        case "&&", (left, right):
            return _and(value_of(left), value_of(right))
        case "||", (left, right):
            return _not(_and(_not(value_of(left)), _not(value_of(right))))
        case _, (left, right) if form in _ARITHMETIC:
            return _calculated(_ARITHMETIC[form], value_of(left), value_of(right))
        case _, operands:
            return _applied(_FUNCTIONS[form], [value_of(operand) for operand in operands])


# --- logic --------------------------------------------------------------------------------------------


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


def _comparison(compare: Callable[[Any, Any], bool], left: Tree, right: Tree) -> Judge:
    if (left.form, right.form) == ("fact", "constant"):
        return _compared_with(compare, left.name, right.value)
    return _applied(compare, [value_of(left), value_of(right)])


def _compared_with(compare: Callable[[Any, Any], bool], name: str, constant: object) -> Judge:
    """The usual comparison: every candidate is judged by it."""

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


def _distance(one: str, other: str) -> Judge:
    axes = [(f"{one}.{axis}", f"{other}.{axis}") for axis in POSITION]

    def judge(facts: Facts) -> float | None:
        squares = 0.0
        for here, there in axes:
            first, second = facts.get(here), facts.get(there)
            if first is None or second is None:
                return None
            squares += (_real(first) - _real(second)) ** 2
        return math.sqrt(squares)

    return judge
