"""Exponential, natural logarithm, and powers (table J.9, decision 58)."""

from __future__ import annotations

from math import copysign

from lfield.vm.maths.constants import (
    EXPONENTIAL,
    FIFTH,
    FIFTH_LOW,
    INFINITY,
    LN2,
    LN2_LOW,
    LOGARITHM,
    ONE_OVER_LN2,
    THIRD,
    THIRD_LOW,
)
from lfield.vm.maths.double_doubles import (
    add,
    divide,
    exponent,
    multiply,
    quick_sum,
    scaled,
    two_product,
    two_sum,
)
from lfield.vm.memory.word_codec import NAN, bits_of_real, real_from_bits

#: Arguments above which e^x overflows, and below which it is 0.
_LARGEST, _SMALLEST = 709.8, -745.2
#: Adding and then subtracting this number rounds to an integer.
_ROUNDING = 6755399441055744.0
_ROOT_OF_2 = 1.4142135623730951
#: From this number on every real is an integer, and from twice this number an even one.
_WHOLE = 4503599627370496.0


def exp(x: float) -> float:
    """e to the power x; infinite on overflow."""
    if x != x:
        return NAN
    return _exponential(x, 0.0)


def log(x: float) -> float:
    """The natural logarithm; minus infinity for 0, NaN below 0."""
    if not x >= 0.0:
        return NAN
    if x == 0.0:
        return -INFINITY
    if x == INFINITY:
        return x
    high, low = _logarithm(x)
    return high + low


def pow(x: float, y: float) -> float:
    """x to the power y, with the special cases of IEEE 754; 0 to a negative power is infinite."""
    if y == 0.0 or x == 1.0:
        return 1.0
    if x != x or y != y:
        return NAN
    if abs(y) == INFINITY:
        return _endless(abs(x), y)
    negative = copysign(1.0, x) < 0.0 and _odd(y)
    if x < 0.0 and x != -INFINITY and not _whole(y):
        return NAN
    size = _size(abs(x), y)
    return -size if negative else size


def _size(x: float, y: float) -> float:
    """|x| to the power y, for finite y other than 0."""
    if x == 0.0 or x == INFINITY:
        return 0.0 if (x == 0.0) == (y > 0.0) else INFINITY
    if x == 1.0:
        return 1.0
    high, low = _logarithm(x)
    about = y * high
    if about > _LARGEST:
        return INFINITY
    if about < _SMALLEST:
        return 0.0
    return _exponential(*multiply(high, low, y, 0.0))


def _endless(x: float, y: float) -> float:
    """x to the power of an infinity."""
    if x == 1.0:
        return 1.0
    return INFINITY if (x > 1.0) == (y > 0.0) else 0.0


def _whole(y: float) -> bool:
    return abs(y) >= _WHOLE or float(int(y)) == y


def _odd(y: float) -> bool:
    return abs(y) < 2.0 * _WHOLE and float(int(y)) == y and int(y) & 1 == 1


def _exponential(x: float, low: float) -> float:
    """e to the power of a pair."""
    if x > _LARGEST:
        return INFINITY
    if x < _SMALLEST:
        return 0.0
    twos = (x * ONE_OVER_LN2 + _ROUNDING) - _ROUNDING
    r, r_low = two_sum(x - twos * LN2, -(twos * LN2_LOW))
    r_low = r_low + low
    sum = 0.0
    for term in EXPONENTIAL:
        sum = sum * r + term
    tail = r * r * sum
    high, rest = quick_sum(1.0, r)
    return scaled(high + (rest + (r_low + r_low * (r + tail) + tail)), int(twos))


def _logarithm(x: float) -> tuple[float, float]:
    """The logarithm of a real above 0 as a pair, accurate to 65 bits."""
    twos = 0
    if x < 2.2250738585072014e-308:
        x = x * 18014398509481984.0
        twos = -54
    twos = twos + exponent(x)
    x = real_from_bits(bits_of_real(x) & 0xFFFFFFFFFFFFF | 0x3FF0000000000000)
    if x > _ROOT_OF_2:
        x = 0.5 * x
        twos = twos + 1
    above, above_low = two_sum(x, 1.0)
    s, s_low = divide(x - 1.0, 0.0, above, above_low)
    square, square_low = multiply(s, s_low, s, s_low)
    sum = 0.0
    for term in LOGARITHM:
        sum = sum * square + term
    u, u_low = add(FIFTH, FIFTH_LOW, square * sum, 0.0)
    u, u_low = multiply(u, u_low, square, square_low)
    u, u_low = add(THIRD, THIRD_LOW, u, u_low)
    u, u_low = multiply(u, u_low, square, square_low)
    u, u_low = multiply(u, u_low, s, s_low)
    high, low = add(2.0 * s, 2.0 * s_low, 2.0 * u, 2.0 * u_low)
    if twos == 0:
        return high, low
    much, much_low = two_product(float(twos), LN2_LOW)
    much, much_low = add(float(twos) * LN2, 0.0, much, much_low)
    return add(much, much_low, high, low)
