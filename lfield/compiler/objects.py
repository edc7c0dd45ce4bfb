"""New objects and arrays: the values that are made in several steps, in the very slot that wants them.

So the wanted slot must be one that nobody reads before the object is complete: a temporary, or a local
that is just being declared.
"""

from __future__ import annotations

from lfield.bytecode.program import MESSAGE
from lfield.compiler.calls import Calls
from lfield.compiler.frame import Evaluator, Frame, Label
from lfield.lang import types
from lfield.lang.tree import Elements, Expr, New, NewArray
from lfield.lang.types import ArrayType, Type


def takes_steps(expr: Expr) -> bool:
    """Whether the slot that wants a value would be written before the value is complete."""
    return isinstance(expr, New | Elements) or (isinstance(expr, NewArray) and len(expr.lengths) > 1)


class Objects:
    """The objects and arrays that one method makes."""

    def __init__(self, frame: Frame, evaluator: Evaluator, calls: Calls) -> None:
        self._frame = frame
        self._evaluator = evaluator
        self._calls = calls

    def new(self, expr: New, wanted: int | None) -> int:
        """`new C(...)`: an object, then its constructor; built-in exceptions just take their message."""
        tables, slots, code = self._frame.tables, self._frame.slots, self._frame.code
        kind = tables.object_type(expr.type.name)
        fits = wanted is not None and slots.types[wanted] == kind
        made = wanted if wanted is not None and fits else slots.temporary(kind)
        code.emit("new", made, tables.class_index(expr.type.name))
        if expr.constructor is not None:
            self._calls.construct(made, tables.method_index(expr.constructor), expr.arguments)
        elif expr.arguments:
            message = self._evaluator.value(expr.arguments[0])
            code.emit("putf", made, MESSAGE, message)
            slots.release(message)
        return self._frame.settle(made, expr.type, wanted)

    def new_array(self, expr: NewArray, wanted: int | None) -> int:
        """`new T[n][m]`: all lengths first, then the outer array, then its elements one by one."""
        lengths = [self._evaluator.operand(length) for length in expr.lengths]
        if len(lengths) == 1:
            self._frame.slots.release(*lengths)
        result = self._frame.result(expr.type, wanted)
        self._fill(result, expr.type, lengths)
        if len(lengths) > 1:
            self._frame.slots.release(*lengths)
        return result

    def elements(self, expr: Elements, wanted: int | None) -> int:
        """`new T[] {a, b}`: the array, then one element after the other into its place."""
        frame, code = self._frame, self._frame.code
        result, index = frame.result(expr.type, wanted), frame.result(types.INT, None)
        length = frame.constant(len(expr.elements))
        code.emit("newarray", result, frame.tables.type_index(expr.type), length)
        for number, element in enumerate(expr.elements):
            value = self._evaluator.operand(element)
            code.emit("move", index, frame.constant(number))
            code.emit("pute", result, index, value)
            frame.slots.release(value)
        frame.slots.release(index)
        return result

    def _fill(self, made: int, array: Type, lengths: list[int]) -> None:
        self._frame.code.emit("newarray", made, self._frame.tables.type_index(array), lengths[0])
        if len(lengths) > 1:
            assert isinstance(array, ArrayType)
            self._fill_elements(made, array.element, lengths)

    def _fill_elements(self, made: int, element: Type, lengths: list[int]) -> None:
        frame, code = self._frame, self._frame.code
        index, more = frame.result(types.INT, None), frame.result(types.BOOLEAN, None)
        inner = frame.result(element, None)
        body, test = Label(), Label()
        code.emit("move", index, frame.constant(0))
        code.jump("jmp", test)
        code.place(body, entered=True)
        self._fill(inner, element, lengths[1:])
        code.emit("pute", made, index, inner)
        code.emit("addi", index, index, frame.constant(1))
        code.place(test)
        code.emit("slti", more, index, lengths[0])
        code.jump("bnz", body, more)
        frame.slots.release(index, more, inner)
