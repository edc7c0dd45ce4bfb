"""What is asked of a whole, as far as it can be asked of its parts before they are combined.

    fork.agent == "f39"                 is asked of the fork alone
    payload >= 400                      of each part, where payload is min(fork.payload, cart.payload)
    agent == "f39"                      of the whole: the fork is f39, or else the cart is
    fork.slot == cart.slot              a join: each fork is put to the carts of its slot only
    fork.payload + cart.payload >= 3    a check: tried, the cheapest first

A condition is rewritten with what the rule says the whole is worth, taken apart, and each piece is given to
the parts that it names. Nothing changes in what is true: unknown stays unknown, and only what is true counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from lfield.capability import condition
from lfield.capability.matching.evaluate import Judge, conjuncts, is_between_parts, named, value_of
from lfield.capability.matching.expression import IDENTITY
from lfield.capability.model import Composition, Expression

#: So many ways to tell who of the parts it is are followed one by one; what is left is tried.
MAX_BRANCHES = 16

_MIRRORED: Mapping[str, str] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}


@dataclass(frozen=True, slots=True)
class Join:
    """Two parts, by their numbers, that must have a value in common; each judge looks at its own part."""

    left: int
    left_value: Judge
    right: int
    right_value: Judge


@dataclass(frozen=True, slots=True)
class Check:
    """A condition over several parts; `looked_at` are its facts: the name, the part, its attribute."""

    judge: Judge
    looked_at: tuple[tuple[str, int, str], ...]
    parts: frozenset[int]


@dataclass(frozen=True, slots=True)
class Narrowed:
    """All that is asked of a whole: of the `parts` by their numbers, between them, and of itself."""

    parts: tuple[tuple[Expression, ...], ...]
    joins: tuple[Join, ...] = ()
    checks: tuple[Check, ...] = ()
    whole: tuple[Expression, ...] = ()


@dataclass(slots=True)
class _Asked:
    """What was found while conditions were taken apart; an alternative is a condition for each part."""

    parts: list[list[Expression]]
    joins: list[Join] = field(default_factory=list)
    checks: list[Check] = field(default_factory=list)
    whole: list[Expression] = field(default_factory=list)
    alternatives: list[tuple[Expression, Expression]] = field(default_factory=list)


def narrow(rule: Composition, asked: Sequence[Expression]) -> list[Narrowed]:
    """The `where` of a rule and what is asked of the whole; no two of the answers have a whole in common."""
    return _Narrowing(rule).narrowed(asked)


class _Narrowing:
    """Takes apart what is asked of the wholes of one rule."""

    def __init__(self, rule: Composition) -> None:
        self._rule = rule
        self._needs = list(rule.needs)
        self._found = _Asked([[*_conjuncts(need.when)] for need in rule.needs.values()])

    def narrowed(self, asked: Sequence[Expression]) -> list[Narrowed]:
        """One for each way to tell who of the parts is meant; none where no whole can be what is asked."""
        for conjunct in (c for where in self._rule.where for c in conjuncts(where)):
            self._of_whole(conjunct)
        for conjunct in asked:
            if self._is_unknown(conjunct.tree):
                return []
            self._of_whole(conjunct)
        found = self._found
        base = Narrowed(
            tuple(map(tuple, found.parts)), tuple(found.joins), tuple(found.checks), tuple(found.whole)
        )
        branches = [base]
        for is_it, is_not in found.alternatives:
            branches = [
                _with(branch, [*([is_not] * number), is_it])
                for branch in branches
                for number in range(len(self._needs))
            ]
        return branches

    def _of_whole(self, conjunct: Expression) -> None:
        """A condition on the whole, or on parts by name."""
        if (who := _identity(conjunct.tree)) is not None:
            self._who(conjunct, *who)
            return
        tree = _replaced(conjunct.tree, self._worth)
        if any("." not in name for name in named(tree)):
            self._found.whole.append(conjunct)
            return
        for piece in _pieces(tree):
            self._piece(piece)

    def _is_unknown(self, tree: condition.Expr) -> bool:
        """Whether a condition on a whole is never known, since the rule does not say what it looks at."""
        match tree:
            case condition.Unary(operand=operand):
                return self._is_unknown(operand)
            case condition.Binary(operator="&&" | "||", left=left, right=right):
                return self._is_unknown(left) and self._is_unknown(right)
        return any(name not in self._rule.attributes and name not in IDENTITY for name in named(tree))

    def _worth(self, tree: condition.Name | condition.Member) -> condition.Expr:
        """What the rule says an attribute of the whole is worth."""
        known = self._rule.attributes.get(tree.name) if isinstance(tree, condition.Name) else None
        return tree if known is None else known.tree

    def _who(
        self, conjunct: Expression, name: condition.Name, sign: str, literal: condition.Literal_
    ) -> None:
        """`agent == "f39"`: one of the parts is; `agent != "f39"`: none is."""
        is_it, is_not = (_expression(_compared(conjunct, name, s, literal)) for s in ("==", "!="))
        if sign == "!=":
            for asked in self._found.parts:
                asked.append(is_not)
        elif len(self._needs) ** (len(self._found.alternatives) + 1) <= MAX_BRANCHES:
            self._found.alternatives.append((is_it, is_not))
        else:
            self._found.whole.append(conjunct)

    def _piece(self, tree: condition.Expr) -> None:
        """A condition over parts, given to those that it names."""
        parts = self._parts_of(tree)
        if len(parts) == 1:
            (part,) = parts
            self._found.parts[part].append(_expression(_replaced(tree, _alone)))
        elif (join := self._join(tree)) is not None:
            self._found.joins.append(join)
        else:
            looked_at = tuple((name, *self._place(name)) for name in dict.fromkeys(named(tree)))
            self._found.checks.append(Check(value_of(tree), looked_at, parts))

    def _join(self, tree: condition.Expr) -> Join | None:
        match tree:
            case condition.Binary(operator="==", left=left, right=right):
                first, second = self._parts_of(left), self._parts_of(right)
                if len(first) == len(second) == 1 and first != second:
                    (one,), (other,) = first, second
                    return Join(
                        one, value_of(_replaced(left, _alone)), other, value_of(_replaced(right, _alone))
                    )
        return None

    def _parts_of(self, tree: condition.Expr) -> frozenset[int]:
        return frozenset(self._place(name)[0] for name in named(tree))

    def _place(self, name: str) -> tuple[int, str]:
        """Which part, and which of its attributes, `need.attribute` is."""
        need, _, attribute = name.partition(".")
        return self._needs.index(need), attribute


def _with(branch: Narrowed, asked: Sequence[Expression]) -> Narrowed:
    """The same with one more condition on each of the first parts."""
    more = [(one,) for one in asked] + [()] * (len(branch.parts) - len(asked))
    parts = tuple((*had, *new) for had, new in zip(branch.parts, more, strict=True))
    return replace(branch, parts=parts)


def _conjuncts(when: Expression | None) -> Iterator[Expression]:
    for conjunct in () if when is None else conjuncts(when):
        yield _expression(conjunct.tree)


def _identity(tree: condition.Expr) -> tuple[condition.Name, str, condition.Literal_] | None:
    """The sides of `agent == "f39"` and the like."""
    match tree:
        case condition.Binary(
            operator="==" | "!=" as sign,
            left=condition.Name(name=name) as left,
            right=condition.Literal_() as right,
        ) if name in IDENTITY:
            return left, sign, right
        case condition.Binary(
            operator="==" | "!=" as sign,
            left=condition.Literal_() as left,
            right=condition.Name(name=name) as right,
        ) if name in IDENTITY:
            return right, sign, left
    return None


def _compared(
    conjunct: Expression, name: condition.Name, sign: str, literal: condition.Literal_
) -> condition.Binary:
    span = conjunct.tree.span
    return condition.Binary(span, 2, sign, span, name, literal)


def _alone(tree: condition.Name | condition.Member) -> condition.Expr:
    """`fork.payload` as the fork itself would say it."""
    return condition.Name(tree.span, 1, tree.name)


def _replaced(
    tree: condition.Expr, leaf: Callable[[condition.Name | condition.Member], condition.Expr]
) -> condition.Expr:
    """A tree with other names at its ends; parts between which a distance is are none of them."""
    match tree:
        case condition.Name() | condition.Member():
            return leaf(tree)
        case condition.Unary(operand=operand):
            return replace(tree, operand=_replaced(operand, leaf))
        case condition.Binary(left=left, right=right):
            return replace(tree, left=_replaced(left, leaf), right=_replaced(right, leaf))
        case condition.Call(arguments=arguments) if not is_between_parts(tree):
            return replace(tree, arguments=[_replaced(argument, leaf) for argument in arguments])
    return tree


def _pieces(tree: condition.Expr) -> Iterator[condition.Expr]:
    """What must all be true so that the tree is: `min(a, b) >= 2` is `a >= 2` and `b >= 2`."""
    match tree:
        case condition.Binary(operator="&&", left=left, right=right):
            yield from _pieces(left)
            yield from _pieces(right)
        case condition.Binary(operator="<" | "<=" | ">" | ">=" as sign, left=left, right=right):
            if isinstance(right, condition.Call):
                left, right, sign = right, left, _MIRRORED[sign]  # type: ignore[assignment]
            least = "min" if sign in (">", ">=") else "max"
            if isinstance(left, condition.Call) and left.function.span.text == least:
                for argument in left.arguments:
                    yield from _pieces(replace(tree, operator=sign, left=argument, right=right))
            else:
                yield tree
        case _:
            yield tree


# --- equal texts are equal conditions ------------------------------------------------------------------


def _expression(tree: condition.Expr) -> Expression:
    """A condition on one part, by a text of its own: parts of which the same is asked are found once."""
    return Asking(_written(tree), tree)


class Asking(Expression):
    """A condition that is known by its text alone."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Asking) and self.text == other.text

    def __hash__(self) -> int:
        return hash(self.text)


def _written(tree: condition.Expr) -> str:
    """A tree as text, with all its parentheses."""
    match tree:
        case condition.Literal_(value=value):
            return repr(value)
        case condition.Name(name=name):
            return name
        case condition.Unary(operator=operator, operand=operand):
            return f"({operator}{_written(operand)})"
        case condition.Binary(operator=operator, left=left, right=right):
            return f"({_written(left)} {operator} {_written(right)})"
        case condition.Call(function=function, arguments=arguments):
            return f"{function.name}({', '.join(map(_written, arguments))})"
    raise ValueError(f"this is no condition on one part: {tree.span.text}")
