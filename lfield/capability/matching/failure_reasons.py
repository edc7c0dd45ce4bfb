"""Explains why a condition is false: `payload 1.2 < 2.0`, `tools is nothing (nominal), not sling`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from lfield.capability import condition_tree
from lfield.capability.matching.condition_evaluator import Facts, conjuncts, evaluator, facts_of, value_of
from lfield.capability.model import Expression, Value
from lfield.text.suggestions import listed

#: The reason why a fact is missing: `payload is not stated`.
ReasonOf = Callable[[str], str]

_NEGATED: Mapping[str, str] = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}


def failure_reasons(
    expression: Expression, facts: Facts, reason_of: ReasonOf, source: Callable[[str], str] = lambda name: ""
) -> tuple[str, ...]:
    """One sentence for each conjunct that is not true, in their order; () when all of them are.

    `source` is the text added to the value of an attribute: its provenance.
    """
    explainer = _Explainer(facts, reason_of, source)
    return tuple(
        explainer.reason(conjunct.tree, True)
        for conjunct in conjuncts(expression)
        if evaluator(conjunct)(facts) is not True
    )


class _Explainer:
    """Explains why conditions over the same facts do not have the expected value."""

    def __init__(self, facts: Facts, reason_of: ReasonOf, source: Callable[[str], str]) -> None:
        self._facts, self._reason_of, self._source = facts, reason_of, source

    def reason(self, tree: condition_tree.ConditionExpr, expected: bool) -> str:
        """The reason why a tree is not `expected`: it has the other value, or is unknown."""
        return " and ".join(dict.fromkeys(self._reasons(tree, expected)))

    def _reasons(self, tree: condition_tree.ConditionExpr, expected: bool) -> Iterator[str]:
        match tree:
            case condition_tree.ConditionUnary(operand=operand):
                yield from self._reasons(operand, not expected)
            case condition_tree.ConditionBinary(operator="&&" | "||", left=left, right=right):
                for side in (left, right):
                    if value_of(side)(self._facts) is not expected:
                        yield from self._reasons(side, expected)
            case _ if value_of(tree)(self._facts) is None:
                yield from self._unknown(tree)
            case condition_tree.ConditionBinary(operator="==" | "!="):
                yield self._equality(tree)
            case condition_tree.ConditionBinary():
                yield self._comparison(tree, expected)
            case _:
                yield f"{tree.span.text} is {_format_value(not expected)}"

    def _unknown(self, tree: condition_tree.ConditionExpr) -> Iterator[str]:
        missing = [name for name in facts_of(tree) if name not in self._facts]
        yield from (self._reason_of(name) for name in missing)
        if not missing:
            yield f"{tree.span.text} has no value"

    # --- comparisons ----------------------------------------------------------------------------------

    def _comparison(self, tree: condition_tree.ConditionBinary, expected: bool) -> str:
        sign = _NEGATED[tree.operator] if expected else tree.operator
        left, right = tree.left, tree.right
        if isinstance(left, condition_tree.ConditionLiteral):
            left, right, sign = right, left, condition_tree.MIRRORED[sign]
        text = f"{self._side(left)} {sign} {self._side(right)}"
        return text if self._differ(left, right) else f"{text} (they differ after the sixth digit)"

    def _differ(self, left: condition_tree.ConditionExpr, right: condition_tree.ConditionExpr) -> bool:
        """Whether two numbers differ as they are shown, or not at all."""
        values = self._value(left), self._value(right)
        return values[0] == values[1] or _format_value(values[0]) != _format_value(values[1])

    def _side(self, tree: condition_tree.ConditionExpr) -> str:
        """An operand with its value, unless it is a literal."""
        text = tree.span.text
        return (
            text if isinstance(tree, condition_tree.ConditionLiteral) else f"{text} {self._value_text(tree)}"
        )

    def _value_text(self, tree: condition_tree.ConditionExpr) -> str:
        """A value, with its source if it is that of an attribute."""
        source = self._source(tree.name) if isinstance(tree, condition_tree.ConditionName) else ""
        return f"{_format_value(self._value(tree))}{source}"

    def _equality(self, tree: condition_tree.ConditionBinary) -> str:
        """The reason why `==` or `!=` is false: the present value, and the required one if that differs."""
        left, right = tree.left, tree.right
        if isinstance(left, condition_tree.ConditionLiteral):
            left, right = right, left
        name, value, other = left.span.text, self._value_text(left), self._value_text(right)
        equal = value_of(tree)(self._facts) is (tree.operator == "==")
        if isinstance(right, condition_tree.ConditionLiteral):
            return f"{name} is {value}" if equal else f"{name} is {value}, not {other}"
        if value == other:
            return f"{name} and {right.span.text} are both {value}"
        return f"{name} is {value}, {right.span.text} is {other}"

    def _value(self, tree: condition_tree.ConditionExpr) -> Value:
        value = value_of(tree)(self._facts)
        assert value is not None
        return value


def _format_value(value: Value) -> str:
    """A value for people: a number with six significant digits."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, frozenset):
        return listed(sorted(value), "nothing")
    if isinstance(value, float):
        return f"{value:.0f}" if value == round(value) and abs(value) < 1e15 else f"{value:.6g}"
    return str(value)
