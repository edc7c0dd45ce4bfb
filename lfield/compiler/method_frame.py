"""One method under construction: its instructions with labels and lines, slots and handlers."""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct, field

from lfield.bytecode.opcodes import BY_NAME
from lfield.bytecode.program import Handler, Quad
from lfield.compiler.slots import Slots
from lfield.compiler.tables import ProgramTables
from lfield.lang.tree import Expr, Local, Method
from lfield.lang.types import Type

_TERMINALS = frozenset({"jmp", "return", "rtn", "throw", "noreturn"})


class Label(Struct, eq=False):
    """A position in the code; `jumps` are the quads to patch when it is placed."""

    position: int | None = None
    jumps: list[int] = field(default_factory=list)


class CodeBuffer:
    """Quads under construction. Positions are those of the whole program: `base` is the method's entry."""

    def __init__(self, base: int) -> None:
        self.quads: list[Quad] = []
        self.lines: list[tuple[int, int]] = []
        #: The source line of the next instructions.
        self.line = 0
        self._is_new_statement = False
        #: Whether the current position is reachable. Unreachable instructions are dropped.
        self.reachable = True
        self._base = base

    def set_line(self, line: int) -> None:
        """Sets the line of the next instructions, on which a statement or a condition begins."""
        self.line, self._is_new_statement = line, True

    @property
    def position(self) -> int:
        """The position of the next instruction."""
        return self._base + len(self.quads)

    def emit(self, name: str, a: int = 0, b: int = 0, c: int = 0) -> None:
        """Append an instruction."""
        if not self.reachable:
            return
        if self._is_new_statement or not self.lines or self.lines[-1][1] != self.line:
            self.lines.append((self.position, self.line))
            self._is_new_statement = False
        self.quads.append(Quad(BY_NAME[name].code, a, b, c))
        self.reachable = name not in _TERMINALS

    def jump(self, name: str, label: Label, condition: int = 0) -> None:
        """Append `jmp`, `bnz` or `bz` to a label that may be placed later."""
        if self.reachable and label.position is None:
            label.jumps.append(len(self.quads))
        self.emit(name, label.position or 0, condition)

    def place(self, label: Label, *, entered: bool = False) -> None:
        """Place a label here. `entered`: it will be reached by a later backward jump or a handler."""
        label.position = self.position
        for index in label.jumps:
            self.quads[index] = self.quads[index]._replace(a=label.position)
        self.reachable = self.reachable or entered or bool(label.jumps)


class MethodFrame(Struct, eq=False):
    """A method under construction: the program's tables, its slots, its code, its handlers.

    `changing` are the locals that the current statement assigns inside an expression: reading one
    copies it, because its value may change before it is used.
    """

    method: Method
    tables: ProgramTables
    slots: Slots
    code: CodeBuffer
    handlers: list[Handler] = field(default_factory=list)
    changing: frozenset[Local] = frozenset()

    def set_changing(self, local_variables: frozenset[Local]) -> None:
        """Set the variables that the next expressions assign."""
        self.changing = local_variables

    def constant(self, value: bool | int | float | None) -> int:
        """A constant as a source operand."""
        return self.tables.pool.operand(value)

    def result(self, kind: Type, target: int | None, *used: int) -> int:
        """A slot for the result of one instruction that reads `used`: the target, or a temporary."""
        self.slots.release(*used)
        return self.slots.temporary(self.tables.type_index(kind)) if target is None else target

    def move_operand(self, operand: int, kind: Type, target: int | None) -> int:
        """The slot of an existing value, moved to the target only if necessary."""
        if operand == target or (target is None and operand >= 0):
            return operand
        result = self.result(kind, target, operand)
        self.code.emit("move", result, operand)
        return result


class Evaluator(Protocol):
    """Interface of expressions.py for the other parts of the second pass."""

    def value(self, expr: Expr, target: int | None = None) -> int:
        """The slot with the value: `target`, if given. The caller releases it."""

    def operand(self, expr: Expr) -> int:
        """The value as a source operand: a constant, or a slot that the caller releases."""
