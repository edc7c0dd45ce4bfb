"""New objects and arrays, which are built in several steps in their target slot.

So no other expression may read the target slot before the object is complete: the slot is a temporary, or a
local under declaration.
"""

from __future__ import annotations

from lfield.bytecode.program import MESSAGE
from lfield.compiler.call_emitter import CallEmitter
from lfield.compiler.method_frame import Evaluator, Label, MethodFrame
from lfield.lang import types
from lfield.lang.tree import Elements, Expr, New, NewArray
from lfield.lang.types import ArrayType, Type


def needs_several_steps(expr: Expr) -> bool:
    """Whether the target slot is written before the value is complete."""
    return isinstance(expr, New | Elements) or (isinstance(expr, NewArray) and len(expr.lengths) > 1)


class ObjectEmitter:
    """Creates the objects and arrays of one method."""

    def __init__(self, frame: MethodFrame, evaluator: Evaluator, calls: CallEmitter) -> None:
        self._frame = frame
        self._evaluator = evaluator
        self._calls = calls

    def new(self, expr: New, target: int | None) -> int:
        """`new C(...)`: an object, then its constructor; built-in exceptions store their message."""
        tables, slots, code = self._frame.tables, self._frame.slots, self._frame.code
        kind = tables.object_type(expr.type.name)
        can_use_target = target is not None and slots.types[target] == kind
        new_slot = target if target is not None and can_use_target else slots.temporary(kind)
        code.emit("new", new_slot, tables.class_index(expr.type.name))
        if expr.constructor is not None:
            self._calls.construct(new_slot, tables.method_index(expr.constructor), expr.arguments)
        elif expr.arguments:
            message = self._evaluator.value(expr.arguments[0])
            code.emit("putf", new_slot, MESSAGE, message)
            slots.release(message)
        return self._frame.move_operand(new_slot, expr.type, target)

    def new_array(self, expr: NewArray, target: int | None) -> int:
        """`new T[n][m]`: all lengths first, then the outer array, then its elements one by one."""
        lengths = [self._evaluator.operand(length) for length in expr.lengths]
        if len(lengths) == 1:
            self._frame.slots.release(*lengths)
        result = self._frame.result(expr.type, target)
        self._fill(result, expr.type, lengths)
        if len(lengths) > 1:
            self._frame.slots.release(*lengths)
        return result

    def elements(self, expr: Elements, target: int | None) -> int:
        """`new T[] {a, b}`: the array, then its elements in order."""
        frame, code = self._frame, self._frame.code
        result, index = frame.result(expr.type, target), frame.result(types.INT, None)
        length = frame.constant(len(expr.elements))
        code.emit("newarray", result, frame.tables.type_index(expr.type), length)
        for number, element in enumerate(expr.elements):
            value = self._evaluator.operand(element)
            code.emit("move", index, frame.constant(number))
            code.emit("pute", result, index, value)
            frame.slots.release(value)
        frame.slots.release(index)
        return result

    def _fill(self, new_slot: int, array: Type, lengths: list[int]) -> None:
        self._frame.code.emit("newarray", new_slot, self._frame.tables.type_index(array), lengths[0])
        if len(lengths) > 1:
            assert isinstance(array, ArrayType)
            self._fill_elements(new_slot, array.element, lengths)

    def _fill_elements(self, new_slot: int, element: Type, lengths: list[int]) -> None:
        frame, code = self._frame, self._frame.code
        index, more = frame.result(types.INT, None), frame.result(types.BOOLEAN, None)
        inner = frame.result(element, None)
        body, test = Label(), Label()
        code.emit("move", index, frame.constant(0))
        code.jump("jmp", test)
        code.place(body, entered=True)
        self._fill(inner, element, lengths[1:])
        code.emit("pute", new_slot, index, inner)
        code.emit("addi", index, index, frame.constant(1))
        code.place(test)
        code.emit("slti", more, index, lengths[0])
        code.jump("bnz", body, more)
        frame.slots.release(index, more, inner)
