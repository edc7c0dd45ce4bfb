"""One method under construction: its instructions with labels and lines, and what it keeps beside them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import Handler, Quad
from lfield.compiler.slots import Slots
from lfield.compiler.tables import Tables
from lfield.lang.tree import Expr, Local, Method
from lfield.lang.types import Type

_TERMINALS = frozenset({"jmp", "return", "rtn", "throw", "noreturn"})


@dataclass(slots=True, eq=False)
class Label:
    """A place in the code, known once it is placed; `jumps` are the quads that wait for it."""

    position: int | None = None
    jumps: list[int] = field(default_factory=list)


class Code:
    """Quads in the making. Positions are those of the whole program: `base` is the method's entry."""

    def __init__(self, base: int) -> None:
        self.quads: list[Quad] = []
        self.lines: list[tuple[int, int]] = []
        #: The source line that instructions come from.
        self.line = 0
        #: Whether control can come here. Where it cannot, instructions are dropped.
        self.reachable = True
        self._base = base

    @property
    def position(self) -> int:
        """Where the next instruction will be."""
        return self._base + len(self.quads)

    def emit(self, name: str, a: int = 0, b: int = 0, c: int = 0) -> None:
        """Append an instruction."""
        if not self.reachable:
            return
        if not self.lines or self.lines[-1][1] != self.line:
            self.lines.append((self.position, self.line))
        self.quads.append(Quad(BY_NAME[name].code, a, b, c))
        self.reachable = name not in _TERMINALS

    def jump(self, name: str, label: Label, condition: int = 0) -> None:
        """Append `jmp`, `bnz` or `bz` to a label that may be placed later."""
        if self.reachable and label.position is None:
            label.jumps.append(len(self.quads))
        self.emit(name, label.position or 0, condition)

    def place(self, label: Label, *, entered: bool = False) -> None:
        """Put a label here. `entered`: control comes by a way not made yet, a jump back or a handler."""
        label.position = self.position
        for index in label.jumps:
            self.quads[index] = self.quads[index]._replace(a=label.position)
        self.reachable = self.reachable or entered or bool(label.jumps)


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


class Evaluator(Protocol):
    """How the parts of the second pass ask for values; expressions.py is the one that answers."""

    def value(self, expr: Expr, wanted: int | None = None) -> int:
        """The slot that has the value: `wanted`, if one is. The caller releases it."""

    def operand(self, expr: Expr) -> int:
        """The value as a source operand: a constant, or a slot to release."""
