"""Conditions and values over attributes as trees, and the mistakes in their texts.

Conditions are written as expressions of L; condition_parser.py makes the trees, matching/condition_checker.py
resolves their names, condition_encoding.py is their form in a bundle.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct

from lfield.text.source_text import Span

#: The greatest height of a tree: trees are walked recursively.
MAX_HEIGHT = 100
#: Largest limit of a query.
MAX_LIMIT = 1000
#: The comparison of exchanged operands, by the comparison.
MIRRORED: Mapping[str, str] = {"<": ">", "<=": ">=", ">": "<", ">=": "<="}
#: The largest team that can be requested.
MAX_TEAM = 1000


class Mistake(Struct, frozen=True):
    """A mistake in a text: characters `start` to `end` of it."""

    start: int
    end: int
    message: str
    hint: str = ""

    def __str__(self) -> str:
        return f"{self.message} ({self.hint})" if self.hint else self.message


class ConditionExpr(Struct, eq=False):
    """An expression; `height` is the height of its tree."""

    span: Span
    height: int


class ConditionLiteral(ConditionExpr, eq=False):
    """A number, text, true, false or null (None)."""

    value: bool | int | float | str | None


class ConditionName(ConditionExpr, eq=False):
    """A bare name."""

    name: str


#: The sorts of values of parameters, by the letter that begins their names in a compiled query.
PARAMETER_SORTS = {"n": "number", "t": "text", "b": "boolean"}


class ConditionParameter(ConditionExpr, eq=False):
    """A value that the program passes: `$kg`, `$at[0]`, `$mass[g]` with its unit.

    `path` is the expression in the program; in a compiled query a letter and a number, `n0`, and no unit.
    """

    path: str
    unit: str = ""

    @property
    def sort(self) -> str:
        """The sort of the value in a compiled query; '' in a query that is not compiled."""
        is_compiled = self.path[1:].isdecimal()
        return PARAMETER_SORTS.get(self.path[:1], "") if is_compiled else ""


class ConditionUnary(ConditionExpr, eq=False):
    """`!x` or `-x`."""

    operator: str
    operand: ConditionExpr


class ConditionBinary(ConditionExpr, eq=False):
    """Any operator with two sides; `sign` is the operator."""

    operator: str
    sign: Span
    left: ConditionExpr
    right: ConditionExpr


class ConditionMember(ConditionExpr, eq=False):
    """`object.name`; `place` is the name."""

    object: ConditionExpr
    name: str
    place: Span


class ConditionCall(ConditionExpr, eq=False):
    """`function(arguments)`, where the function is a Name or a Member."""

    function: ConditionName | ConditionMember
    arguments: list[ConditionExpr]


class ConditionUnsupported(ConditionExpr, eq=False):
    """An expression of L that has no meaning over attributes: `a[0]`, `new T()`, `this`."""
