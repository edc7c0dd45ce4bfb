"""Conditions and comparisons, compiled to branches; a boolean is materialised only where its value is needed.

Only the last source operand of an instruction may be a constant, so `0 < x` becomes `x > 0` (table J.8).
"""

from __future__ import annotations

from lfield.compiler.constant_folding import NotConstant, fold
from lfield.compiler.method_frame import Evaluator, Label, MethodFrame
from lfield.lang import types
from lfield.lang.tree import Binary, Expr, Logical, Not
from lfield.lang.tree_traversal import chain_operands

_NAMES = {"==": "eq", "!=": "sne", "<": "slt", "<=": "sle", ">": "sgt", ">=": "sge"}
_SUFFIXES = {types.INT: "i", types.REAL: "f", types.STRING: "s", types.BOOLEAN: "b"}
#: The equivalent operator with exchanged sides.
_MIRRORED = {"+": "+", "*": "*", "==": "==", "!=": "!=", "<": ">", "<=": ">=", ">": "<", ">=": "<="}


def constant_last(expr: Binary) -> tuple[Expr, Expr]:
    """The sides of an operation, exchanged when that makes a constant the last one.

    A constant has no side effect, so the order of evaluation is preserved.
    """
    if expr.op in _MIRRORED and not isinstance(fold(expr.left), NotConstant | str):
        return expr.right, expr.left
    return expr.left, expr.right


def comparison(expr: Binary) -> tuple[str, Expr, Expr]:
    """The comparison instruction, and its source operands in order."""
    left, right = constant_last(expr)
    op = expr.op if left is expr.left else _MIRRORED[expr.op]
    plain = types.INT if isinstance(expr.left.type, types.EnumType) else expr.left.type
    return _NAMES[op] + _SUFFIXES.get(plain, "r"), left, right


def tested_for_null(expr: Expr) -> Expr | None:
    """The operand that is compared with null, if any."""
    if not isinstance(expr, Binary) or expr.op not in ("==", "!="):
        return None
    if fold(expr.right) is None:
        return expr.left
    return expr.right if fold(expr.left) is None else None


class ConditionEmitter:
    """The conditions of one method."""

    def __init__(self, frame: MethodFrame, evaluator: Evaluator) -> None:
        self._frame = frame
        self._evaluator = evaluator

    def branch(self, expr: Expr, when: bool, label: Label) -> None:
        """Jump to the label when the condition is `when`, else fall through."""
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
        decides = expr.op == "||"  # the value of a term that decides the condition
        *firsts, last = chain_operands(expr)
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
