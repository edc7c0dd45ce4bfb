"""Conditions: control goes where they say; no boolean is made where a branch is meant."""

from __future__ import annotations

from lfield.compiler import comparisons
from lfield.compiler.code import Label
from lfield.compiler.constants import fold
from lfield.compiler.frame import Evaluator, Frame
from lfield.lang import types
from lfield.lang.tree import Binary, Expr, Logical, Not


class Conditions:
    """The conditions of one method."""

    def __init__(self, frame: Frame, evaluator: Evaluator) -> None:
        self._frame = frame
        self._evaluator = evaluator

    def branch(self, expr: Expr, when: bool, label: Label) -> None:
        """Jump to the label when the condition is `when`, else go on."""
        constant = fold(expr)
        if isinstance(constant, bool):
            if constant == when:
                self._frame.code.jump("jmp", label)
            return
        match expr:
            case Not():
                self.branch(expr.operand, not when, label)
            case Logical():
                self._short_circuit(expr, when, label)
            case Binary(op="!=") if (tested := comparisons.tested_for_null(expr)) is not None:
                self._on_slot(self._is_null(tested), not when, label)
            case _:
                self._on_slot(self._evaluator.value(expr), when, label)

    def _short_circuit(self, expr: Logical, when: bool, label: Label) -> None:
        decides = expr.op == "||"  # the value of the left side that makes the right side superfluous
        if decides == when:
            self.branch(expr.left, when, label)
            self.branch(expr.right, when, label)
        else:
            skip = Label()
            self.branch(expr.left, not when, skip)
            self.branch(expr.right, when, label)
            self._frame.code.place(skip)

    def _is_null(self, expr: Expr) -> int:
        tested = self._evaluator.operand(expr)
        result = self._frame.result(types.BOOLEAN, None, tested)
        self._frame.code.emit("eqnull", result, tested)
        return result

    def _on_slot(self, condition: int, when: bool, label: Label) -> None:
        self._frame.slots.release(condition)
        self._frame.code.jump("bnz" if when else "bz", label, condition)
