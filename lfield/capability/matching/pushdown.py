"""Predicate pushdown: moves the condition of a composition to its parts before they are combined.

    fork.agent == "f39"                 a condition on the fork
    payload >= 400                      on each part, where payload is min(fork.payload, cart.payload)
    agent == "f39"                      on the composition: the fork is f39, or else the cart is
    fork.slot == cart.slot              a join: each fork is combined with the carts of its slot only
    fork.slot == cart.slot || far < 9   a choice: two searches, with and without the join
    fork.payload + cart.payload >= 3    a check of combinations, cheapest first

The rule's attributes are substituted into the condition, which is split into conjuncts, each assigned to the
parts that it names. The result is equivalent in three-valued logic; only true results count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from msgspec import Struct, field
from msgspec.structs import replace

from lfield.capability import condition_tree
from lfield.capability.matching.condition_checker import IDENTITY
from lfield.capability.matching.condition_evaluator import (
    Facts,
    Judge,
    conjuncts,
    facts_of,
    is_between_parts,
    value_of,
)
from lfield.capability.model import Composition, Expression, Value

#: The most alternatives of a part's identity that are followed one by one; the rest is searched.
MAX_BRANCHES = 16

_OPPOSITE: Mapping[str, str] = {"==": "!=", "!=": "==", "<": ">=", ">=": "<", "<=": ">", ">": "<="}


class Join(Struct, frozen=True):
    """A join of two parts, by number, on a common value; each key function applies to its own part."""

    left: int
    left_value: Judge
    right: int
    right_value: Judge


class PartCheck(Struct, frozen=True):
    """A condition over several parts; `inputs` are its facts: the name, the part, its attribute."""

    judge: Judge
    inputs: tuple[tuple[str, int, str], ...]
    parts: frozenset[int]


class PushedDown(Struct, frozen=True):
    """The split condition: on single `parts` by number, between parts, and on the composition."""

    parts: tuple[tuple[Expression, ...], ...]
    joins: tuple[Join, ...] = ()
    checks: tuple[PartCheck, ...] = ()
    whole: tuple[Expression, ...] = ()


class _Collected(Struct):
    """The conditions found while others were split.

    An alternative is a condition for each part, of a choice at least one side is true.
    """

    parts: list[list[Expression]]
    joins: list[Join] = field(default_factory=list)
    checks: list[PartCheck] = field(default_factory=list)
    whole: list[Expression] = field(default_factory=list)
    alternatives: list[tuple[Expression, Expression]] = field(default_factory=list)
    choices: list[tuple[condition_tree.ConditionExpr, condition_tree.ConditionExpr]] = field(
        default_factory=list
    )


def push_down(rule: Composition, conditions: Sequence[Expression]) -> list[PushedDown]:
    """Splits the `where` of a rule and the condition of a query into alternatives with disjoint results."""
    return _PushDown(rule).run(conditions)


class _PushDown:
    """Splits the conditions on the compositions of one rule."""

    def __init__(self, rule: Composition) -> None:
        self._rule = rule
        self._needs = list(rule.needs)
        self._found = _Collected([[*_conjuncts(need.when)] for need in rule.needs.values()])
        #: The number of searches.
        self._searches = 1

    def run(self, conditions: Sequence[Expression]) -> list[PushedDown]:
        """One result for each alternative of the part; none if the condition cannot be satisfied."""
        for conjunct in (c for where in self._rule.where for c in conjuncts(where)):
            self._of_whole(conjunct)
        for conjunct in conditions:
            if self._is_unknown(conjunct.tree):
                return []
            self._of_whole(conjunct)
        found = self._found
        branches = self._grown(PushedDown(((),) * len(self._needs)), found)
        for is_it, is_not in found.alternatives:
            branches = [
                _with(branch, [*([is_not] * number), is_it])
                for branch in branches
                for number in range(len(self._needs))
            ]
        return branches

    def _grown(self, branch: PushedDown, found: _Collected) -> list[PushedDown]:
        """The branches with one more condition: one for each alternative."""
        parts = tuple((*had, *new) for had, new in zip(branch.parts, found.parts, strict=True))
        joins, checks = (*branch.joins, *found.joins), (*branch.checks, *found.checks)
        branches = [PushedDown(parts, joins, checks, (*branch.whole, *found.whole))]
        for left, right in found.choices:
            # Results for which both sides are true are found by the first.
            first, second = self._collect(left), self._collect(right)
            second.checks.append(self._check(left, lambda judge, facts: judge(facts) is not True))
            branches = [more for b in branches for side in (first, second) for more in self._grown(b, side)]
        return branches

    def _collect(self, tree: condition_tree.ConditionExpr) -> _Collected:
        """The condition of one side of a disjunction."""
        before, self._found = self._found, _Collected([[] for _ in self._needs])
        for piece in _pieces(tree):
            self._on_part_condition(piece)
        found, self._found = self._found, before
        return found

    def _has_budget_for(self, times: int) -> bool:
        """Multiplies the number of searches if the limit permits; returns whether it does."""
        if self._searches * times > MAX_BRANCHES:
            return False
        self._searches *= times
        return True

    def _of_whole(self, conjunct: Expression) -> None:
        """Splits a condition on the whole, or on parts by name."""
        if (identity := _identity(conjunct.tree)) is not None:
            self._on_identity(conjunct, *identity)
            return
        tree = _replaced(conjunct.tree, self._definition_of)
        if any("." not in name for name in facts_of(tree)):
            self._found.whole.append(conjunct)
            return
        for piece in _pieces(tree):
            self._on_part_condition(piece)

    def _is_unknown(self, tree: condition_tree.ConditionExpr) -> bool:
        """Whether a condition on a whole is always unknown, since the rule lacks an attribute in it."""
        match tree:
            case condition_tree.ConditionUnary(operand=operand):
                return self._is_unknown(operand)
            case condition_tree.ConditionBinary(operator="&&" | "||", left=left, right=right):
                return self._is_unknown(left) and self._is_unknown(right)
        return any(name not in self._rule.attributes and name not in IDENTITY for name in facts_of(tree))

    def _definition_of(
        self, tree: condition_tree.ConditionName | condition_tree.ConditionMember
    ) -> condition_tree.ConditionExpr:
        """The rule's expression for an attribute of the whole."""
        known = (
            self._rule.attributes.get(tree.name) if isinstance(tree, condition_tree.ConditionName) else None
        )
        return tree if known is None else known.tree

    def _on_identity(
        self,
        conjunct: Expression,
        name: condition_tree.ConditionName,
        sign: str,
        literal: condition_tree.ConditionLiteral,
    ) -> None:
        """Splits `agent == "f39"` (one part is the agent) or `agent != "f39"` (no part is)."""
        is_it, is_not = (_expression(_compared(conjunct, name, s, literal)) for s in ("==", "!="))
        if sign == "!=":
            for conditions in self._found.parts:
                conditions.append(is_not)
        elif self._has_budget_for(len(self._needs)):
            self._found.alternatives.append((is_it, is_not))
        else:
            self._found.whole.append(conjunct)

    def _on_part_condition(self, tree: condition_tree.ConditionExpr) -> None:
        """Assigns a condition over parts to the parts that it names."""
        parts = self._parts_of(tree)
        if len(parts) == 1:
            (part,) = parts
            self._found.parts[part].append(_expression(_replaced(tree, _alone)))
        elif (join := self._join(tree)) is not None:
            self._found.joins.append(join)
        elif (
            isinstance(tree, condition_tree.ConditionBinary) and tree.operator == "||" and self._divides(tree)
        ):
            self._found.choices.append((tree.left, tree.right))
        else:
            self._found.checks.append(self._check(tree, lambda judge, facts: judge(facts)))

    def _check(
        self, tree: condition_tree.ConditionExpr, verdict: Callable[[Judge, Facts], Value | None]
    ) -> PartCheck:
        read_facts = tuple((name, *self._place(name)) for name in dict.fromkeys(facts_of(tree)))
        return PartCheck(partial(verdict, value_of(tree)), read_facts, self._parts_of(tree))

    def _divides(self, tree: condition_tree.ConditionBinary) -> bool:
        """Whether two searches, one for each side, would try less than one."""
        sides = [piece for side in (tree.left, tree.right) for piece in _pieces(side)]
        prunes = any(len(self._parts_of(piece)) == 1 or self._join(piece) is not None for piece in sides)
        return prunes and self._has_budget_for(2)

    def _join(self, tree: condition_tree.ConditionExpr) -> Join | None:
        match tree:
            case condition_tree.ConditionBinary(operator="==", left=left, right=right):
                first, second = self._parts_of(left), self._parts_of(right)
                if len(first) == len(second) == 1 and first != second:
                    (left_part,), (right_part,) = first, second
                    return Join(
                        left_part,
                        value_of(_replaced(left, _alone)),
                        right_part,
                        value_of(_replaced(right, _alone)),
                    )
        return None

    def _parts_of(self, tree: condition_tree.ConditionExpr) -> frozenset[int]:
        return frozenset(self._place(name)[0] for name in facts_of(tree))

    def _place(self, name: str) -> tuple[int, str]:
        """The part, by number, and the attribute of `need.attribute`."""
        need, _, attribute = name.partition(".")
        return self._needs.index(need), attribute


def _with(branch: PushedDown, conditions: Sequence[Expression]) -> PushedDown:
    """The result with one more condition on each of the first parts."""
    more = [(condition,) for condition in conditions] + [()] * (len(branch.parts) - len(conditions))
    parts = tuple((*had, *new) for had, new in zip(branch.parts, more, strict=True))
    return replace(branch, parts=parts)


def _conjuncts(when: Expression | None) -> Iterator[Expression]:
    for conjunct in () if when is None else conjuncts(when):
        yield _expression(conjunct.tree)


def _identity(
    tree: condition_tree.ConditionExpr,
) -> tuple[condition_tree.ConditionName, str, condition_tree.ConditionLiteral] | None:
    """The sides of `agent == "f39"` and similar comparisons."""
    match tree:
        case condition_tree.ConditionBinary(
            operator="==" | "!=" as sign,
            left=condition_tree.ConditionName(name=name) as left,
            right=condition_tree.ConditionLiteral() as right,
        ) if name in IDENTITY:
            return left, sign, right
        case condition_tree.ConditionBinary(
            operator="==" | "!=" as sign,
            left=condition_tree.ConditionLiteral() as left,
            right=condition_tree.ConditionName(name=name) as right,
        ) if name in IDENTITY:
            return right, sign, left
    return None


def _compared(
    conjunct: Expression,
    name: condition_tree.ConditionName,
    sign: str,
    literal: condition_tree.ConditionLiteral,
) -> condition_tree.ConditionBinary:
    span = conjunct.tree.span
    return condition_tree.ConditionBinary(span, 2, sign, span, name, literal)


def _alone(
    tree: condition_tree.ConditionName | condition_tree.ConditionMember,
) -> condition_tree.ConditionExpr:
    """The name of an attribute for its part alone: `payload` for `fork.payload`."""
    return condition_tree.ConditionName(tree.span, 1, tree.name)


def _replaced(
    tree: condition_tree.ConditionExpr,
    leaf: Callable[
        [condition_tree.ConditionName | condition_tree.ConditionMember], condition_tree.ConditionExpr
    ],
) -> condition_tree.ConditionExpr:
    """A tree with replaced names at its leaves; the parts of a distance between parts are kept."""
    match tree:
        case condition_tree.ConditionName() | condition_tree.ConditionMember():
            return leaf(tree)
        case condition_tree.ConditionUnary(operand=operand):
            return replace(tree, operand=_replaced(operand, leaf))
        case condition_tree.ConditionBinary(left=left, right=right):
            return replace(tree, left=_replaced(left, leaf), right=_replaced(right, leaf))
        case condition_tree.ConditionCall(arguments=arguments) if not is_between_parts(tree):
            return replace(tree, arguments=[_replaced(argument, leaf) for argument in arguments])
    return tree


def _pieces(tree: condition_tree.ConditionExpr) -> Iterator[condition_tree.ConditionExpr]:
    """The conditions that must all be true for the tree to be true: `min(a, b) >= 2` is `a >= 2` and `b >=
    2`.
    """
    match tree:
        case condition_tree.ConditionUnary(operator="!", operand=operand) if (
            inner := _negated(operand)
        ) is not None:
            yield from _pieces(inner)
        case condition_tree.ConditionBinary(operator="&&", left=left, right=right):
            yield from _pieces(left)
            yield from _pieces(right)
        case condition_tree.ConditionBinary(operator="<" | "<=" | ">" | ">=" as sign, left=left, right=right):
            if isinstance(right, condition_tree.ConditionCall):
                # The pattern has narrowed the type of `sign` to the four comparisons.
                left, right, sign = right, left, condition_tree.MIRRORED[sign]  # type: ignore[assignment]
            function = "min" if sign in (">", ">=") else "max"
            if isinstance(left, condition_tree.ConditionCall) and left.function.span.text == function:
                for argument in left.arguments:
                    yield from _pieces(replace(tree, operator=sign, left=argument, right=right))
            else:
                yield tree
        case _:
            yield tree


def _negated(tree: condition_tree.ConditionExpr) -> condition_tree.ConditionExpr | None:
    """The condition that is true where the tree is false, and unknown where it is unknown; None if it
    would be only the negation.
    """
    match tree:
        case condition_tree.ConditionUnary(operator="!", operand=operand):
            return operand
        case condition_tree.ConditionBinary(operator=sign) if sign in _OPPOSITE:
            return replace(tree, operator=_OPPOSITE[sign])
        case condition_tree.ConditionBinary(operator="&&" | "||" as sign, left=left, right=right):
            not_left, not_right = (
                condition_tree.ConditionUnary(side.span, side.height + 1, "!", side) for side in (left, right)
            )
            return replace(tree, operator="||" if sign == "&&" else "&&", left=not_left, right=not_right)
    return None


# --- equal texts are equal conditions ------------------------------------------------------------------


def _expression(tree: condition_tree.ConditionExpr) -> Expression:
    """A condition on one part, with a canonical text: parts with the same condition are searched once."""
    return TextCondition(_written(tree), tree)


class TextCondition(Expression):
    """A condition that is known by its text alone."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TextCondition) and self.text == other.text

    def __hash__(self) -> int:
        return hash(self.text)


def _written(tree: condition_tree.ConditionExpr) -> str:
    """A tree as text, with all its parentheses."""
    match tree:
        case condition_tree.ConditionLiteral(value=value):
            return repr(value)
        case condition_tree.ConditionName(name=name):
            return name
        case condition_tree.ConditionUnary(operator=operator, operand=operand):
            return f"({operator}{_written(operand)})"
        case condition_tree.ConditionBinary(operator=operator, left=left, right=right):
            return f"({_written(left)} {operator} {_written(right)})"
        case condition_tree.ConditionCall(function=function, arguments=arguments):
            return f"{function.name}({', '.join(map(_written, arguments))})"
    raise ValueError(f"this is not a condition on one part: {tree.span.text}")
