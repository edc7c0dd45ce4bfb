"""Arithmetic, comparisons and logic (tables J.6 to J.8).

Writing a number beyond 64 bits into the block fails, which the engine turns into an ArithmeticException;
steps need no overflow check. Computed reals have the single NaN of L; moves, fields and elements preserve all
bits.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

from lfield.vm.engine_interface import Trap
from lfield.vm.maths.rounding import remainder
from lfield.vm.memory.layout import PROXY_MEMBER
from lfield.vm.memory.word_codec import canonical
from lfield.vm.reference.call_steps import Registers, Step

Int2 = Callable[[int, int], int]
Real2 = Callable[[float, float], float]
Compare = Callable[[Any, Any], Any]


def _divide(a: int, b: int) -> int:
    quotient = abs(a) // abs(b)
    return quotient if (a < 0) == (b < 0) else -quotient


def _remainder(a: int, b: int) -> int:
    rest = abs(a) % abs(b)
    return -rest if a < 0 else rest


def _divide_real(a: float, b: float) -> float:
    return a / b


def _remainder_real(a: float, b: float) -> float:
    if b == 0.0 or math.isinf(a):
        raise Trap("ArithmeticException", "remainder of a division by zero or of infinity")
    return remainder(a, b)


INT: dict[str, Int2] = {
    "addi": operator.add,
    "subi": operator.sub,
    "muli": operator.mul,
    "divi": _divide,
    "mod": _remainder,
    "eqi": operator.eq,
    "slei": operator.le,
    "sgei": operator.ge,
    "snei": operator.ne,
    "slti": operator.lt,
    "sgti": operator.gt,
    "and": operator.and_,
    "or": operator.or_,
    "eqb": operator.eq,
    "sneb": operator.ne,
    "eqr": operator.eq,
    "sner": operator.ne,
}

REAL: dict[str, Real2] = {
    "addf": operator.add,
    "subf": operator.sub,
    "mulf": operator.mul,
    "divf": _divide_real,
    "modf": _remainder_real,
}

REAL_COMPARE: dict[str, Compare] = {
    "eqf": operator.eq,
    "slef": operator.le,
    "sgef": operator.ge,
    "snef": operator.ne,
    "sltf": operator.lt,
    "sgtf": operator.gt,
}

STRING_COMPARE: dict[str, Compare] = {
    "eqs": operator.eq,
    "sles": operator.le,
    "sges": operator.ge,
    "snes": operator.ne,
    "slts": operator.lt,
    "sgts": operator.gt,
}

INT_UNARY: dict[str, Callable[[int], int]] = {
    "negi": operator.neg,
    "not": operator.not_,
    "eqnull": operator.not_,
}


def int_binary(function: Int2, a: int, b: int, c: int | None, constant: int, after: int) -> Step:
    """`a = b function c` on ints, booleans or references; c is None when the operand is a constant."""
    if c is None:

        def with_constant(m: Registers) -> int:
            w, slots = m.w, m.slots
            w[slots + a] = function(w[slots + b], constant)
            return after

        return with_constant

    slot = c

    def with_slot(m: Registers) -> int:
        w, slots = m.w, m.slots
        w[slots + a] = function(w[slots + b], w[slots + slot])
        return after

    return with_slot


def real_binary(function: Real2, a: int, b: int, c: int | None, constant: float, after: int) -> Step:
    """`a = b function c` on reals."""

    def step(m: Registers) -> int:
        r, slots = m.r, m.slots
        r[slots + a] = canonical(function(r[slots + b], constant if c is None else r[slots + c]))
        return after

    return step


def real_compare(function: Compare, a: int, b: int, c: int | None, constant: float, after: int) -> Step:
    """`a = b function c`, reals compared."""

    def step(m: Registers) -> int:
        r, slots = m.r, m.slots
        m.w[slots + a] = function(r[slots + b], constant if c is None else r[slots + c])
        return after

    return step


def string_compare(function: Compare, a: int, b: int, c: int | None, after: int) -> Step:
    """`a = b function c`, strings compared by content; null equals only null and has no order."""
    ordered = function not in (operator.eq, operator.ne)

    def step(m: Registers) -> int:
        w, slots, block = m.w, m.slots, m.block
        left, right = w[slots + b], 0 if c is None else w[slots + c]
        if ordered and not (left and right):
            raise Trap("NullException", "comparison with a null string")
        w[slots + a] = function(block.string(left) if left else None, block.string(right) if right else None)
        return after

    return step


def proxy_compare(is_equality: bool, a: int, b: int, c: int | None, after: int) -> Step:
    """`a = whether b and c are for the same agent` (or not), regardless of their origin."""

    def step(m: Registers) -> int:
        w, slots = m.w, m.slots
        left, right = w[slots + b], 0 if c is None else w[slots + c]
        if left and right:
            left, right = w[left + PROXY_MEMBER], w[right + PROXY_MEMBER]
        w[slots + a] = (left == right) == is_equality
        return after

    return step


def int_unary(function: Callable[[int], int], a: int, b: int | None, constant: int, after: int) -> Step:
    """`a = function b` on ints, booleans or references."""

    def step(m: Registers) -> int:
        m.w[m.slots + a] = function(constant if b is None else m.w[m.slots + b])
        return after

    return step


def real_negate(a: int, b: int | None, constant: float, after: int) -> Step:
    """`a = -b` on reals."""

    def step(m: Registers) -> int:
        m.r[m.slots + a] = canonical(-(constant if b is None else m.r[m.slots + b]))
        return after

    return step
