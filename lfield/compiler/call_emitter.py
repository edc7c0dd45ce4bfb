"""Calls: instructions with arguments on the parameter stack, as a group (see opcodes.py).

All arguments are evaluated first, left to right, and then pushed in order.
"""

from __future__ import annotations

from collections.abc import Sequence

from lfield.compiler.method_frame import Evaluator, MethodFrame
from lfield.lang.language_library import GROWTH
from lfield.lang.tree import (
    Call,
    DeviceCall,
    Expr,
    Find,
    LibraryCall,
    Literal_,
    LoopCall,
    Method,
    PortalCall,
    Query,
)
from lfield.lang.types import NULL, Type


class CallEmitter:
    """The calls of one method."""

    def __init__(self, frame: MethodFrame, evaluator: Evaluator) -> None:
        self._frame = frame
        self._evaluator = evaluator

    def value(self, expr: Expr, target: int | None) -> int:
        """Call, and pop the result."""
        self.emit_group(expr)
        return self._popped(expr.type, target)

    def library(self, name: str, arguments: Sequence[Expr], kind: Type, target: int | None) -> int:
        """Call a library instruction, and pop its result."""
        self._evaluated(name, arguments)
        return self._popped(kind, target)

    def emit_group(self, expr: Expr) -> None:
        """Call; the pop of a result must follow."""
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
                query = [constraint] if expr.size is None else [constraint, expr.size]
                self._evaluated(head, query, tables.class_index(expr.capability.name))
            case LoopCall(other=Method() as other):
                self._evaluated(expr.operation, [], tables.method_index(other))
            case LibraryCall(operation=operation) if operation in GROWTH:
                self._evaluated(operation, expr.arguments, tables.type_index(expr.arguments[0].type))
            case LibraryCall():
                self._evaluated(expr.operation, expr.arguments)
            case DeviceCall():
                index = tables.device_call(expr, self._frame.method.unit)
                device = [expr.device] if isinstance(expr.device, Expr) else []
                self._evaluated("device", [*device, *expr.arguments], index)
            case _:
                raise AssertionError(f"a {type(expr).__name__} is not a call")

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
        """Push operands for a call instruction; the pop of a result must follow."""
        for operand in operands:
            self._frame.code.emit("push", operand)
        self._frame.code.emit(head, index)

    def _popped(self, kind: Type, target: int | None) -> int:
        result = self._frame.result(kind, target)
        self._frame.code.emit("pop", result)
        return result
