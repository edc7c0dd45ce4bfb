"""What every part of the second pass works on: one method under construction."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from lfield.bytecode.program import Handler
from lfield.compiler.code import Code
from lfield.compiler.collect import Tables
from lfield.compiler.slots import Slots
from lfield.lang.tree import Expr, Local, Method
from lfield.lang.types import Type


class Evaluator(Protocol):
    """How the parts of the second pass ask for values; expressions.py is the one that answers."""

    def value(self, expr: Expr, wanted: int | None = None) -> int:
        """The slot that has the value: `wanted`, if one is. The caller releases it."""

    def operand(self, expr: Expr) -> int:
        """The value as a source operand: a constant, or a slot to release."""


@dataclass(slots=True, eq=False)
class Frame:
    """A method under construction: the program's tables, its slots, its code, its handlers.

    `changing` are the locals that the current statement assigns in the middle of an expression: reading one
    takes a copy, because its value may change before it is used.
    """

    method: Method
    tables: Tables
    slots: Slots
    code: Code
    handlers: list[Handler] = field(default_factory=list)
    changing: frozenset[Local] = frozenset()

    def constant(self, value: bool | int | float | None) -> int:
        """A constant as a source operand."""
        return self.tables.pool.operand(value)

    def result(self, kind: Type, wanted: int | None, *used: int) -> int:
        """A slot for the result of one instruction that reads `used`: the one wanted, or a temporary."""
        self.slots.release(*used)
        return self.slots.temporary(self.tables.type_index(kind)) if wanted is None else wanted

    def settle(self, operand: int, kind: Type, wanted: int | None) -> int:
        """Where a value that is there already is wanted: moved only if it must be."""
        if operand == wanted or (wanted is None and operand >= 0):
            return operand
        result = self.result(kind, wanted, operand)
        self.code.emit("move", result, operand)
        return result
