"""Exact functions: rounding, minimum, maximum, remainder (tables J.7, J.9).

No result is rounded. The functions do not use built-in ones, since WebAssembly has no remainder, and its
rounding has other signs of 0 than L.
"""

from __future__ import annotations

from math import copysign, sqrt

from lfield.vm.maths.constants import INFINITY
from lfield.vm.maths.double_doubles import exponent, scaled
from lfield.vm.memory.word_codec import NAN, bits_of_real

#: From this number on every real is an integer.
_WHOLE = 4503599627370496.0


def floor(x: float) -> float:
    """The next integer down; 0.0 for -0.0."""
    if not abs(x) < _WHOLE:
        return x
    whole = float(int(x))
    return whole - 1.0 if whole > x else whole


def ceil(x: float) -> float:
    """The next integer up; 0.0 above -1."""
    if not abs(x) < _WHOLE:
        return x
    whole = float(int(x))
    return whole + 1.0 if whole < x else whole


def round(x: float) -> float:
    """The nearest integer, halves away from zero; a 0 keeps its sign."""
    if not abs(x) < _WHOLE:
        return x
    whole = float(int(abs(x)))
    return copysign(whole + 1.0 if abs(x) - whole >= 0.5 else whole, x)


def magnitude(x: float) -> float:
    """The absolute value."""
    return abs(x)


def root(x: float) -> float:
    """The square root; NaN below 0."""
    return sqrt(x) if x >= 0.0 else NAN


def smaller(a: float, b: float) -> float:
    """The minimum; NaN if either is NaN, and -0.0 is smaller than 0.0."""
    if a != a or b != b:
        return NAN
    if a == b:
        return a if copysign(1.0, a) < 0.0 else b
    return a if a < b else b


def larger(a: float, b: float) -> float:
    """The maximum, with the rules of `smaller`."""
    return -smaller(-a, -b)


def remainder(a: float, b: float) -> float:
    """The remainder of a / b with the sign of a; NaN for b = 0."""
    if b == 0.0 or b != b or not abs(a) < INFINITY:
        return NAN
    if abs(a) < abs(b):
        return a
    power = _power(b)
    divisor, rest = _mantissa(b), _mantissa(a)
    rest = rest % divisor
    left = _power(a) - power
    while left > 0 and rest > 0:
        step = left if left < 10 else 10
        rest = (rest << step) % divisor
        left = left - step
    return copysign(scaled(float(rest), power - 52), a)


def _power(x: float) -> int:
    found = exponent(x)
    return found if found > -1023 else -1022


def _mantissa(x: float) -> int:
    """The 53-bit mantissa m of a finite real without sign: x = m * 2^(power - 52)."""
    bits = bits_of_real(x) & 0xFFFFFFFFFFFFF
    return bits if exponent(x) == -1023 else bits | 0x10000000000000
