"""Calls: whatever takes its arguments from the parameter stack, as a group (opcodes.py says why).

All arguments are evaluated first, left to right, and then pushed one after another.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.compiler.frame import Evaluator, Frame
from lfield.lang.tree import Call, DeviceCall, Expr, Find, Library, Literal_, PortalCall, Query
from lfield.lang.types import NULL, Type


class Calls:
    """The calls of one method."""

    def __init__(self, frame: Frame, evaluator: Evaluator) -> None:
        self._frame = frame
        self._evaluator = evaluator

    def value(self, expr: Expr, wanted: int | None) -> int:
        """Call, and pop the result."""
        self.group(expr)
        return self._popped(expr.type, wanted)

    def library(self, name: str, arguments: Sequence[Expr], kind: Type, wanted: int | None) -> int:
        """Call a library instruction, and pop its result."""
        self._evaluated(name, arguments)
        return self._popped(kind, wanted)

    def group(self, expr: Expr) -> None:
        """Call; a result is left for the pop that must follow."""
        tables = self._frame.tables
        match expr:
            case Call():
                self._evaluated("call", [expr.object, *expr.arguments], tables.method_index(expr.method))
            case PortalCall():
                self._evaluated("pcall", [expr.proxy, *expr.arguments], tables.method_index(expr.portal))
            case Find(id=None):
                self._evaluated("findall", [], tables.class_index(expr.resource.name))
            case Find(id=Expr() as name):
                self._evaluated("find", [name], tables.class_index(expr.resource.name))
            case Query():
                head = "offers" if expr.verb == "find" else expr.verb
                constraint = expr.constraint or Literal_(expr.span, NULL, None)
                asked = [constraint] if expr.size is None else [constraint, expr.size]
                self._evaluated(head, asked, tables.class_index(expr.capability.name))
            case Library():
                self._evaluated(expr.operation, expr.arguments)
            case DeviceCall():
                index = tables.device_call(expr, self._frame.method.unit)
                given = [expr.device] if isinstance(expr.device, Expr) else []
                self._evaluated("device", [*given, *expr.arguments], index)
            case _:
                raise AssertionError(f"a {type(expr).__name__} is no call")

    def construct(self, slot: int, constructor: int, arguments: Sequence[Expr]) -> None:
        """Call a constructor on the new object in a slot."""
        operands = self.operands(arguments)
        self.push("call", [slot, *operands], constructor)
        self._frame.slots.release(*operands)

    def _evaluated(self, head: str, arguments: Sequence[Expr], index: int = 0) -> None:
        operands = self.operands(arguments)
        self.push(head, operands, index)
        self._frame.slots.release(*operands)

    def operands(self, arguments: Sequence[Expr]) -> list[int]:
        """The values of arguments, from left to right, to push and to release."""
        return [self._evaluator.operand(argument) for argument in arguments]

    def push(self, head: str, operands: Sequence[int], index: int = 0) -> None:
        """Push operands for a head; a result is left for the pop that must follow."""
        for operand in operands:
            self._frame.code.emit("push", operand)
        self._frame.code.emit(head, index)

    def _popped(self, kind: Type, wanted: int | None) -> int:
        result = self._frame.result(kind, wanted)
        self._frame.code.emit("pop", result)
        return result
