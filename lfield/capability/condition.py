"""Conditions and values over attributes as trees, and what is wrong with their texts.

They are written as expressions are in L; condition_reader.py makes the trees. What the names mean is for
matching/expression.py.
"""

from __future__ import annotations

from dataclasses import dataclass

from lfield.text.source import Span


@dataclass(frozen=True, slots=True)
class Mistake:
    """What is wrong with a text, where: characters `start` to `end` of it."""

    start: int
    end: int
    message: str
    hint: str = ""

    def __str__(self) -> str:
        return f"{self.message} ({self.hint})" if self.hint else self.message


@dataclass(slots=True, eq=False)
class Expr:
    """An expression; `height` is the height of its tree."""

    span: Span
    height: int


@dataclass(slots=True, eq=False)
class Literal_(Expr):
    """A number, text, true, false or null (None)."""

    value: bool | int | float | str | None


@dataclass(slots=True, eq=False)
class Name(Expr):
    """A bare name."""

    name: str


@dataclass(slots=True, eq=False)
class Unary(Expr):
    """`!x` or `-x`."""

    operator: str
    operand: Expr


@dataclass(slots=True, eq=False)
class Binary(Expr):
    """Any operator with two sides; `sign` is where the operator stands."""

    operator: str
    sign: Span
    left: Expr
    right: Expr


@dataclass(slots=True, eq=False)
class Member(Expr):
    """`object.name`; `place` is where the name stands."""

    object: Expr
    name: str
    place: Span


@dataclass(slots=True, eq=False)
class Call(Expr):
    """`function(arguments)`, where the function is a Name or a Member."""

    function: Name | Member
    arguments: list[Expr]


@dataclass(slots=True, eq=False)
class Meaningless(Expr):
    """An expression of L that says nothing over attributes: `a[0]`, `new T()`, `this`."""
