"""Expressions: every value goes straight to the slot that wants it.

With a wanted slot, the result is there and, but for new objects (objects.py), only the last instruction
writes to it: what the expression still reads, and what a handler sees after a failure, is unchanged until
then. Without one, the result is where it is cheapest: in the slot of a local, or in a temporary.
"""

from __future__ import annotations

from bisect import bisect_left

from lfield.compiler.calls import Calls
from lfield.compiler.conditions import Conditions, comparison, constant_last, tested_for_null
from lfield.compiler.constants import Unknown, fold
from lfield.compiler.frame import Frame, Label
from lfield.compiler.objects import Objects, takes_steps
from lfield.lang import types
from lfield.lang.chains import chain, first_evaluated
from lfield.lang.tree import (
    Assign,
    Binary,
    Call,
    DeviceCall,
    Element,
    Elements,
    Expr,
    FieldGet,
    Find,
    Library,
    LocalGet,
    Logical,
    Negate,
    New,
    NewArray,
    Not,
    PortalCall,
    Query,
    This,
    ToReal,
)

_ARITHMETIC = {
    types.INT: {"+": "addi", "-": "subi", "*": "muli", "/": "divi", "%": "mod"},
    types.REAL: {"+": "addf", "-": "subf", "*": "mulf", "/": "divf", "%": "modf"},
}


def _is_computed(expr: Expr) -> bool:
    return isinstance(fold(expr), Unknown)


class Expressions:
    """The expressions of one method; see frame.Evaluator for the rules of `value` and `operand`."""

    def __init__(self, frame: Frame) -> None:
        self._frame = frame
        self._code = frame.code
        self._calls = Calls(frame, self)
        self._objects = Objects(frame, self, self._calls)
        self._conditions = Conditions(frame, self)
        #: Slots of values that are made already, before those which begin with them (chains.py).
        self._ready: dict[Expr, int] = {}

    def operand(self, expr: Expr) -> int:
        """A constant where the expression is one, else a slot; the caller releases it."""
        constant = Unknown.VALUE if expr in self._ready else fold(expr)
        return self.value(expr) if isinstance(constant, Unknown | str) else self._frame.constant(constant)

    def effect(self, expr: Expr) -> None:
        """Evaluate for what it does; a value is dropped."""
        if isinstance(expr, Assign) and isinstance(expr.target, LocalGet):
            self._assign_local(expr.target, expr.value)
        elif isinstance(expr, Assign):
            self._frame.slots.release(self._assign(expr))
        elif expr.type == types.VOID:
            self._calls.group(expr)
        else:
            self._frame.slots.release(self.value(expr))

    def branch(self, expr: Expr, when: bool, label: Label) -> None:
        """Jump to the label when the condition is `when`, else go on."""
        self._conditions.branch(expr, when, label)

    def value(self, expr: Expr, wanted: int | None = None) -> int:
        """The slot that has the value: `wanted`, if one is. The caller releases it."""
        if expr in self._ready:
            return self._frame.settle(self._ready.pop(expr), expr.type, wanted)
        links = chain(expr, first_evaluated)
        for link in links[bisect_left(links, True, key=_is_computed) :]:
            self._ready[link] = self._found(link, None)
        return self._value(expr, wanted)

    def _value(self, expr: Expr, wanted: int | None) -> int:
        constant = fold(expr)
        if isinstance(constant, str):
            result = self._frame.result(expr.type, wanted)
            self._code.emit("lds", result, self._frame.tables.pool.number(constant))
            return result
        if not isinstance(constant, Unknown):
            return self._frame.settle(self._frame.constant(constant), expr.type, wanted)
        return self._found(expr, wanted)

    def _found(self, expr: Expr, wanted: int | None) -> int:
        """Values that are no constants."""
        match expr:
            case This():
                return self._frame.settle(0, expr.type, wanted)
            case LocalGet():
                return self._local(expr, wanted)
            case FieldGet():
                return self._field(expr, wanted)
            case Element():
                return self._element(expr, wanted)
            case Assign():
                return self._frame.settle(self._assign(expr), expr.type, wanted)
        return self._computed(expr, wanted)

    def _computed(self, expr: Expr, wanted: int | None) -> int:
        """Values that are not read from somewhere, but made."""
        match expr:
            case Binary(op="+") if expr.type == types.STRING:
                return self._calls.library("str_concat", [expr.left, expr.right], expr.type, wanted)
            case Binary() if expr.type == types.BOOLEAN:
                return self._comparison(expr, wanted)
            case Binary():
                name = _ARITHMETIC[expr.type][expr.op]
                sides = (expr.left, expr.right) if expr.left in self._ready else constant_last(expr)
                return self._binary(name, *sides, expr, wanted)
            case Negate():
                return self._unary("negi" if expr.type == types.INT else "negf", expr.operand, expr, wanted)
            case Not():
                return self._unary("not", expr.operand, expr, wanted)
            case Logical():
                return self._logical(expr, wanted)
            case ToReal():
                return self._calls.library("i2f", [expr.operand], expr.type, wanted)
            case New():
                return self._objects.new(expr, wanted)
            case NewArray():
                return self._objects.new_array(expr, wanted)
            case Elements():
                return self._objects.elements(expr, wanted)
            case Call() | PortalCall() | Find() | Query() | Library() | DeviceCall():
                return self._calls.value(expr, wanted)
        raise AssertionError(f"there is no value of a {type(expr).__name__}")

    # --- values that are somewhere already ----------------------------------------------------------

    def _local(self, expr: LocalGet, wanted: int | None) -> int:
        if wanted is None and expr.local in self._frame.changing:
            wanted = self._frame.result(expr.type, None)
        return self._frame.settle(self._frame.slots.of(expr.local), expr.type, wanted)

    def _field(self, expr: FieldGet, wanted: int | None) -> int:
        holder = self.value(expr.object)
        result = self._frame.result(expr.type, wanted, holder)
        self._code.emit("getf", result, holder, expr.field.index)
        return result

    def _element(self, expr: Element, wanted: int | None) -> int:
        array = self.value(expr.array)
        index = self.operand(expr.index)
        result = self._frame.result(expr.type, wanted, array, index)
        self._code.emit("gete", result, array, index)
        return result

    def _assign(self, expr: Assign) -> int:
        """Assign; gives the value assigned, as an operand to release."""
        target = expr.target
        if isinstance(target, LocalGet):
            self._assign_local(target, expr.value)
            return self._local(target, None)
        if isinstance(target, FieldGet):
            holder = self.value(target.object)
            value = self.operand(expr.value)
            self._code.emit("putf", holder, target.field.index, value)
            self._frame.slots.release(holder)
            return value
        array = self.value(target.array)
        index = self.value(target.index)
        value = self.operand(expr.value)
        self._code.emit("pute", array, index, value)
        self._frame.slots.release(array, index)
        return value

    def _assign_local(self, target: LocalGet, value: Expr) -> None:
        slot = self._frame.slots.of(target.local)
        if takes_steps(value):
            # Made elsewhere and moved: a constructor may read the local, or fail inside a try.
            self._frame.slots.release(self._frame.settle(self.value(value), value.type, slot))
        else:
            self.value(value, slot)

    # --- operators ----------------------------------------------------------------------------------

    def _unary(self, name: str, operand: Expr, expr: Expr, wanted: int | None) -> int:
        source = self.operand(operand)
        result = self._frame.result(expr.type, wanted, source)
        self._code.emit(name, result, source)
        return result

    def _binary(self, name: str, left: Expr, right: Expr, expr: Expr, wanted: int | None) -> int:
        first = self.value(left)
        second = self.operand(right)
        result = self._frame.result(expr.type, wanted, first, second)
        self._code.emit(name, result, first, second)
        return result

    def _comparison(self, expr: Binary, wanted: int | None) -> int:
        tested = tested_for_null(expr)
        if tested is None:
            name, left, right = comparison(expr)
            return self._binary(name, left, right, expr, wanted)
        result = self._unary("eqnull", tested, expr, wanted if expr.op == "==" else None)
        if expr.op == "==":
            return result
        negated = self._frame.result(expr.type, wanted, result)
        self._code.emit("not", negated, result)
        return negated

    def _logical(self, expr: Logical, wanted: int | None) -> int:
        if isinstance(expr.right, LocalGet):
            # Reading a local does nothing and cannot fail, so it may be read whether needed or not.
            return self._binary("and" if expr.op == "&&" else "or", expr.left, expr.right, expr, wanted)
        otherwise, end = Label(), Label()
        self.branch(expr, False, otherwise)
        result = self._frame.result(expr.type, wanted)
        self._code.emit("move", result, self._frame.constant(True))
        self._code.jump("jmp", end)
        self._code.place(otherwise)
        self._code.emit("move", result, self._frame.constant(False))
        self._code.place(end)
        return result
