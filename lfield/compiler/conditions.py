"""Conditions and comparisons: control goes where they say; no boolean is made where a branch is meant.

Only the last source operand of an instruction may be a constant, so `0 < x` becomes `x > 0` (table J.8).
"""

from __future__ import annotations

from lfield.compiler.constants import Unknown, fold
from lfield.compiler.frame import Evaluator, Frame, Label
from lfield.lang import types
from lfield.lang.chains import terms
from lfield.lang.tree import Binary, Expr, Logical, Not

_NAMES = {"==": "eq", "!=": "sne", "<": "slt", "<=": "sle", ">": "sgt", ">=": "sge"}
_SUFFIXES = {types.INT: "i", types.REAL: "f", types.STRING: "s", types.BOOLEAN: "b"}
#: The operator that says the same with its sides exchanged.
_MIRRORED = {"+": "+", "*": "*", "==": "==", "!=": "!=", "<": ">", "<=": ">=", ">": "<", ">=": "<="}


def constant_last(expr: Binary) -> tuple[Expr, Expr]:
    """The sides of an operation, exchanged when that makes a constant the last one.

    A constant has no effect, so the order of evaluation stays what the source says.
    """
    if expr.op in _MIRRORED and not isinstance(fold(expr.left), Unknown | str):
        return expr.right, expr.left
    return expr.left, expr.right


def comparison(expr: Binary) -> tuple[str, Expr, Expr]:
    """The comparison instruction, and its source operands in order."""
    left, right = constant_last(expr)
    op = expr.op if left is expr.left else _MIRRORED[expr.op]
    return _NAMES[op] + _SUFFIXES.get(expr.left.type, "r"), left, right


def tested_for_null(expr: Expr) -> Expr | None:
    """The side that is compared with null, if one is."""
    if not isinstance(expr, Binary) or expr.op not in ("==", "!="):
        return None
    if fold(expr.right) is None:
        return expr.left
    return expr.right if fold(expr.left) is None else None


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
            case Binary(op="!=") if (tested := tested_for_null(expr)) is not None:
                self._on_slot(self._is_null(tested), not when, label)
            case _:
                self._on_slot(self._evaluator.value(expr), when, label)

    def _short_circuit(self, expr: Logical, when: bool, label: Label) -> None:
        decides = expr.op == "||"  # the value of a term that makes those behind it superfluous
        *firsts, last = terms(expr)
        skip = Label()
        for term in firsts:
            self.branch(term, decides, label if decides == when else skip)
        self.branch(last, when, label)
        self._frame.code.place(skip)

    def _is_null(self, expr: Expr) -> int:
        tested = self._evaluator.operand(expr)
        result = self._frame.result(types.BOOLEAN, None, tested)
        self._frame.code.emit("eqnull", result, tested)
        return result

    def _on_slot(self, condition: int, when: bool, label: Label) -> None:
        self._frame.slots.release(condition)
        self._frame.code.jump("bnz" if when else "bz", label, condition)
