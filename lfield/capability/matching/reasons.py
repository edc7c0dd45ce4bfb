"""Why a condition is not true, in words: `payload 1.2 < 2.0`, `tools is nothing (nominal), not sling`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from lfield.capability import condition
from lfield.capability.matching.evaluate import Facts, conjuncts, evaluator, named, value_of
from lfield.capability.model import Expression, Value
from lfield.text.suggest import listed

#: Says of a fact that is not there why it is not: `payload is not stated`.
Why = Callable[[str], str]

_NEGATED: Mapping[str, str] = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}
_MIRRORED: Mapping[str, str] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


def reasons(
    expression: Expression, facts: Facts, why: Why, source: Callable[[str], str] = lambda name: ""
) -> tuple[str, ...]:
    """One sentence for each conjunct that is not true, in their order; () when all of them are.

    `source` says what is to be added to the value of an attribute: where it is from.
    """
    teller = _Teller(facts, why, source)
    return tuple(
        teller.reason(conjunct.tree, True)
        for conjunct in conjuncts(expression)
        if evaluator(conjunct)(facts) is not True
    )


class _Teller:
    """Tells of conditions over the same facts why they are not what was wanted."""

    def __init__(self, facts: Facts, why: Why, source: Callable[[str], str]) -> None:
        self._facts, self._why, self._source = facts, why, source

    def reason(self, tree: condition.Expr, wanted: bool) -> str:
        """Why this is not `wanted`: it is the other, or unknown."""
        return " and ".join(dict.fromkeys(self._reasons(tree, wanted)))

    def _reasons(self, tree: condition.Expr, wanted: bool) -> Iterator[str]:
        match tree:
            case condition.Unary(operand=operand):
                yield from self._reasons(operand, not wanted)
            case condition.Binary(operator="&&" | "||", left=left, right=right):
                for side in (left, right):
                    if value_of(side)(self._facts) is not wanted:
                        yield from self._reasons(side, wanted)
            case _ if value_of(tree)(self._facts) is None:
                yield from self._unknown(tree)
            case condition.Binary(operator="==" | "!="):
                yield self._equality(tree)
            case condition.Binary():
                yield self._comparison(tree, wanted)
            case _:
                yield f"{tree.span.text} is {_shown(not wanted)}"

    def _unknown(self, tree: condition.Expr) -> Iterator[str]:
        missing = [name for name in named(tree) if name not in self._facts]
        yield from (self._why(name) for name in missing)
        if not missing:
            yield f"{tree.span.text} has no value"

    # --- comparisons ----------------------------------------------------------------------------------

    def _comparison(self, tree: condition.Binary, wanted: bool) -> str:
        sign = _NEGATED[tree.operator] if wanted else tree.operator
        left, right = tree.left, tree.right
        if isinstance(left, condition.Literal_):
            left, right, sign = right, left, _MIRRORED[sign]
        return f"{self._side(left)} {sign} {self._side(right)}"

    def _side(self, tree: condition.Expr) -> str:
        """What is compared, with its value unless it says that itself."""
        text = tree.span.text
        return text if isinstance(tree, condition.Literal_) else f"{text} {self._said(tree)}"

    def _said(self, tree: condition.Expr) -> str:
        """A value, and where it is from if it is that of an attribute."""
        source = self._source(tree.name) if isinstance(tree, condition.Name) else ""
        return f"{_shown(self._value(tree))}{source}"

    def _equality(self, tree: condition.Binary) -> str:
        """Why `==` is false or `!=` is: what is there, and what was wanted if that is something else."""
        left, right = tree.left, tree.right
        if isinstance(left, condition.Literal_):
            left, right = right, left
        name, value, other = left.span.text, self._said(left), self._said(right)
        equal = value_of(tree)(self._facts) is (tree.operator == "==")
        if isinstance(right, condition.Literal_):
            return f"{name} is {value}" if equal else f"{name} is {value}, not {other}"
        if value == other:
            return f"{name} and {right.span.text} are both {value}"
        return f"{name} is {value}, {right.span.text} is {other}"

    def _value(self, tree: condition.Expr) -> Value:
        value = value_of(tree)(self._facts)
        assert value is not None
        return value


def _shown(value: Value) -> str:
    """A value for people; of a number all digits, so that the sentence is true as it stands."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, frozenset):
        return listed(sorted(value), "nothing")
    if isinstance(value, float):
        return f"{value:.0f}" if value == round(value) and abs(value) < 1e15 else repr(value)
    return str(value)
