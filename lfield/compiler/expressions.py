"""Expressions: every value is computed directly in its target slot.

With a target, only the last instruction writes to it, except for new objects (object_emitter.py): operands of
the expression, and values that a handler reads after a failure, are unchanged until then. Without a target,
the result is in the slot of a local, or in a temporary, whichever is cheaper.
"""

from __future__ import annotations

from bisect import bisect_left

from lfield.compiler.call_emitter import CallEmitter
from lfield.compiler.condition_emitter import ConditionEmitter, comparison, constant_last, tested_for_null
from lfield.compiler.constant_folding import NotConstant, fold
from lfield.compiler.future_emitter import FutureEmitter
from lfield.compiler.method_frame import Label, MethodFrame
from lfield.compiler.object_emitter import ObjectEmitter, needs_several_steps
from lfield.lang import types
from lfield.lang.tree import (
    Assign,
    Async,
    Binary,
    Call,
    DeviceCall,
    Element,
    Elements,
    Expr,
    FieldGet,
    Find,
    LibraryCall,
    LocalGet,
    Logical,
    Negate,
    New,
    NewArray,
    Not,
    PortalCall,
    Query,
    Relabel,
    This,
    ToReal,
)
from lfield.lang.tree_traversal import first_evaluated_operand, left_spine

_ARITHMETIC = {
    types.INT: {"+": "addi", "-": "subi", "*": "muli", "/": "divi", "%": "mod"},
    types.REAL: {"+": "addf", "-": "subf", "*": "mulf", "/": "divf", "%": "modf"},
}


def _is_computed(expr: Expr) -> bool:
    return isinstance(fold(expr), NotConstant)


class ExpressionEmitter:
    """The expressions of one method; see frame.Evaluator for the rules of `value` and `operand`."""

    def __init__(self, frame: MethodFrame) -> None:
        self._frame = frame
        self._code = frame.code
        self._calls = CallEmitter(frame, self)
        self._objects = ObjectEmitter(frame, self, self._calls)
        self._futures = FutureEmitter(frame, self._calls)
        self._conditions = ConditionEmitter(frame, self)
        #: Slots of values that were computed in advance, before the expressions that start with them
        #: (tree_traversal.py).
        self._ready: dict[Expr, int] = {}

    def operand(self, expr: Expr) -> int:
        """A constant if the expression is one, else a slot; the caller releases it."""
        constant = NotConstant.VALUE if expr in self._ready else fold(expr)
        return self.value(expr) if isinstance(constant, NotConstant | str) else self._frame.constant(constant)

    def effect(self, expr: Expr) -> None:
        """Evaluate for side effects; the value is dropped."""
        if isinstance(expr, Assign) and isinstance(expr.target, LocalGet):
            self._assign_local(expr.target, expr.value)
        elif isinstance(expr, Assign):
            self._frame.slots.release(self._assign(expr))
        elif expr.type == types.VOID:
            self._calls.emit_group(expr)
        else:
            self._frame.slots.release(self.value(expr))

    def branch(self, expr: Expr, when: bool, label: Label) -> None:
        """Jump to the label when the condition is `when`, else fall through."""
        self._conditions.branch(expr, when, label)

    def value(self, expr: Expr, target: int | None = None) -> int:
        """The slot with the value: `target`, if given. The caller releases it."""
        if expr in self._ready:
            return self._frame.move_operand(self._ready.pop(expr), expr.type, target)
        links = left_spine(expr, first_evaluated_operand)
        for link in links[bisect_left(links, True, key=_is_computed) :]:
            self._ready[link] = self._found(link, None)
        return self._value(expr, target)

    def _value(self, expr: Expr, target: int | None) -> int:
        constant = fold(expr)
        if isinstance(constant, str):
            result = self._frame.result(expr.type, target)
            self._code.emit("lds", result, self._frame.tables.pool.number(constant))
            return result
        if not isinstance(constant, NotConstant):
            return self._frame.move_operand(self._frame.constant(constant), expr.type, target)
        return self._found(expr, target)

    def _found(self, expr: Expr, target: int | None) -> int:
        """The value of an expression that is not constant."""
        match expr:
            case This():
                return self._frame.move_operand(0, expr.type, target)
            case LocalGet():
                return self._local(expr, target)
            case FieldGet():
                return self._field(expr, target)
            case Element():
                return self._element(expr, target)
            case Assign():
                return self._frame.move_operand(self._assign(expr), expr.type, target)
        return self._computed(expr, target)

    def _computed(self, expr: Expr, target: int | None) -> int:
        """The value of an expression that is computed, not read from a variable."""
        match expr:
            case Binary(op="+") if expr.type == types.STRING:
                return self._calls.library("str_concat", [expr.left, expr.right], expr.type, target)
            case Binary() if expr.type == types.BOOLEAN:
                return self._comparison(expr, target)
            case Binary():
                name = _ARITHMETIC[expr.type][expr.op]
                sides = (expr.left, expr.right) if expr.left in self._ready else constant_last(expr)
                return self._binary(name, *sides, expr, target)
            case Negate():
                return self._unary("negi" if expr.type == types.INT else "negf", expr.operand, expr, target)
            case Not():
                return self._unary("not", expr.operand, expr, target)
            case Logical():
                return self._logical(expr, target)
            case Relabel():
                return self.value(expr.operand, target)
            case ToReal():
                return self._calls.library("i2f", [expr.operand], expr.type, target)
            case New():
                return self._objects.new(expr, target)
            case NewArray():
                return self._objects.new_array(expr, target)
            case Elements():
                return self._objects.elements(expr, target)
            case Async():
                return self._futures.start(expr, target)
            case Call() | PortalCall() | Find() | Query() | LibraryCall() | DeviceCall():
                return self._calls.value(expr, target)
        raise AssertionError(f"a {type(expr).__name__} has no value")

    # --- variables ----------------------------------------------------------------------------------

    def _local(self, expr: LocalGet, target: int | None) -> int:
        if target is None and expr.local in self._frame.changing:
            target = self._frame.result(expr.type, None)
        return self._frame.move_operand(self._frame.slots.of(expr.local), expr.type, target)

    def _field(self, expr: FieldGet, target: int | None) -> int:
        holder = self.value(expr.object)
        result = self._frame.result(expr.type, target, holder)
        self._code.emit("getf", result, holder, expr.field.index)
        return result

    def _element(self, expr: Element, target: int | None) -> int:
        array = self.value(expr.array)
        index = self.operand(expr.index)
        result = self._frame.result(expr.type, target, array, index)
        self._code.emit("gete", result, array, index)
        return result

    def _assign(self, expr: Assign) -> int:
        """Assign; returns the assigned value, as an operand to release."""
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
        if needs_several_steps(value):
            # Computed elsewhere and moved: a constructor may read the local, or fail inside a try.
            self._frame.slots.release(self._frame.move_operand(self.value(value), value.type, slot))
        else:
            self.value(value, slot)

    # --- operators ----------------------------------------------------------------------------------

    def _unary(self, name: str, operand: Expr, expr: Expr, target: int | None) -> int:
        source = self.operand(operand)
        result = self._frame.result(expr.type, target, source)
        self._code.emit(name, result, source)
        return result

    def _binary(self, name: str, left: Expr, right: Expr, expr: Expr, target: int | None) -> int:
        first = self.value(left)
        second = self.operand(right)
        result = self._frame.result(expr.type, target, first, second)
        self._code.emit(name, result, first, second)
        return result

    def _comparison(self, expr: Binary, target: int | None) -> int:
        tested = tested_for_null(expr)
        if tested is None:
            name, left, right = comparison(expr)
            return self._binary(name, left, right, expr, target)
        result = self._unary("eqnull", tested, expr, target if expr.op == "==" else None)
        if expr.op == "==":
            return result
        negated = self._frame.result(expr.type, target, result)
        self._code.emit("not", negated, result)
        return negated

    def _logical(self, expr: Logical, target: int | None) -> int:
        if isinstance(expr.right, LocalGet):
            # Reading a local has no effect and cannot fail, so it may be read even if it is not needed.
            return self._binary("and" if expr.op == "&&" else "or", expr.left, expr.right, expr, target)
        otherwise, end = Label(), Label()
        self.branch(expr, False, otherwise)
        result = self._frame.result(expr.type, target)
        self._code.emit("move", result, self._frame.constant(True))
        self._code.jump("jmp", end)
        self._code.place(otherwise)
        self._code.emit("move", result, self._frame.constant(False))
        self._code.place(end)
        return result
