"""Why a condition is not true, in words: `payload 1.2 < 2.0`, `environment is aerial, not terrestrial`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from lfield.capability.matching.evaluate import Facts, conjuncts, evaluator, named, value_of
from lfield.capability.model import Expression, Tree, Value
from lfield.text.suggest import listed

#: Says of a fact that is not there why it is not: `payload is not stated`.
Why = Callable[[str], str]

_NEGATED: Mapping[str, str] = {"<": ">=", "<=": ">", ">": "<=", ">=": "<"}
_MIRRORED: Mapping[str, str] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


def reasons(expression: Expression, facts: Facts, why: Why) -> tuple[str, ...]:
    """One sentence for each conjunct that is not true, in their order; () when all of them are."""
    teller = _Teller(facts, why)
    return tuple(
        teller.reason(conjunct.tree, True)
        for conjunct in conjuncts(expression)
        if evaluator(conjunct)(facts) is not True
    )


class _Teller:
    """Tells of conditions over the same facts why they are not what was wanted."""

    def __init__(self, facts: Facts, why: Why) -> None:
        self._facts, self._why = facts, why

    def reason(self, tree: Tree, wanted: bool) -> str:
        """Why this is not `wanted`: it is the other, or unknown."""
        return " and ".join(dict.fromkeys(self._reasons(tree, wanted)))

    def _reasons(self, tree: Tree, wanted: bool) -> Iterator[str]:
        match tree.form:
            case "!":
                yield from self._reasons(tree.operands[0], not wanted)
            case "&&" | "||":
                for side in tree.operands:
                    if value_of(side)(self._facts) is not wanted:
                        yield from self._reasons(side, wanted)
            case _ if value_of(tree)(self._facts) is None:
                yield from self._unknown(tree)
            case "==" | "!=":
                yield self._equality(tree)
            case "<" | "<=" | ">" | ">=":
                yield self._comparison(tree, wanted)
            case _:
                yield f"{tree.text} is {_shown(not wanted)}"

    def _unknown(self, tree: Tree) -> Iterator[str]:
        missing = [name for name in named(tree) if name not in self._facts]
        yield from (self._why(name) for name in missing)
        if not missing:
            yield f"{tree.text} has no value"

    # --- comparisons ----------------------------------------------------------------------------------

    def _comparison(self, tree: Tree, wanted: bool) -> str:
        sign = _NEGATED[tree.form] if wanted else tree.form
        left, right = tree.operands
        if left.form == "constant":
            left, right, sign = right, left, _MIRRORED[sign]
        return f"{self._side(left)} {sign} {self._side(right)}"

    def _side(self, tree: Tree) -> str:
        """What is compared, with its value unless it says that itself."""
        return tree.text if tree.form == "constant" else f"{tree.text} {_shown(self._value(tree))}"

    def _equality(self, tree: Tree) -> str:
        """Why `==` is false or `!=` is: what is there, and what was wanted if that is something else."""
        left, right = tree.operands
        if left.form == "constant":
            left, right = right, left
        value, other = _shown(self._value(left)), _shown(self._value(right))
        equal = value_of(tree)(self._facts) is (tree.form == "==")
        if right.form == "constant":
            return f"{left.text} is {value}" if equal else f"{left.text} is {value}, not {other}"
        if value == other:
            return f"{left.text} and {right.text} are both {value}"
        return f"{left.text} is {value}, {right.text} is {other}"

    def _value(self, tree: Tree) -> Value:
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
