"""Sine, cosine and tangent of radians of any size (table J.9, decision 58).

Argument reduction to within pi / 4 of 0: up to 800,000 quarter turns with pi / 2 in four parts (Cody and
Waite), above that with as many digits of 2 / pi as the exponent needs (Payne and Hanek).
"""

from __future__ import annotations

from lfield.vm.maths.constants import (
    COSINE,
    HALF_PI,
    HALF_PI_LOW,
    INFINITY,
    QUARTER_1,
    QUARTER_2,
    QUARTER_3,
    QUARTER_4,
    SINE,
    TWO_OVER_PI,
    TWO_OVER_PI_DIGITS,
)
from lfield.vm.maths.double_doubles import add, divide, multiply, quick_sum, two_product, two_sum
from lfield.vm.memory.word_codec import NAN, bits_of_real

#: Half a quarter turn.
_SMALL = 0.7853981633974483
#: Below this angle the parts of pi / 2 suffice.
_NEAR = 800000.0
#: Adding and then subtracting this number rounds to an integer.
_ROUNDING = 6755399441055744.0
_DIGIT = 0xFFFFFFF
#: Weights of the digits after the units.
_FIRST, _SECOND, _THIRD, _FOURTH, _FIFTH, _SIXTH = (2.0 ** (-28 * place) for place in range(1, 7))
#: Below this an angle equals its sine and tangent.
_TINY = 7.450580596923828e-09


def sin(x: float) -> float:
    """The sine; NaN for an infinity."""
    if not abs(x) < INFINITY:
        return NAN
    if abs(x) < _TINY:
        return x
    quarter, r, r_low = _reduced(x)
    if quarter & 1 == 0:
        high, low = _sine(r, r_low)
    else:
        high, low = _cosine(r, r_low)
    return -(high + low) if quarter & 2 != 0 else high + low


def cos(x: float) -> float:
    """The cosine; NaN for an infinity."""
    if not abs(x) < INFINITY:
        return NAN
    quarter, r, r_low = _reduced(x)
    if quarter & 1 == 0:
        high, low = _cosine(r, r_low)
    else:
        high, low = _sine(r, r_low)
    return -(high + low) if (quarter + 1) & 2 != 0 else high + low


def tan(x: float) -> float:
    """The tangent; NaN for an infinity."""
    if not abs(x) < INFINITY:
        return NAN
    if abs(x) < _TINY:
        return x
    quarter, r, r_low = _reduced(x)
    s, s_low = _sine(r, r_low)
    c, c_low = _cosine(r, r_low)
    if quarter & 1 == 0:
        high, low = divide(s, s_low, c, c_low)
    else:
        high, low = divide(-c, -c_low, s, s_low)
    return high + low


def _sine(r: float, low: float) -> tuple[float, float]:
    """The sine of a pair within pi / 4 of 0."""
    square = r * r
    sum = 0.0
    for term in SINE:
        sum = sum * square + term
    return quick_sum(r, low * (1.0 - 0.5 * square) + r * square * sum)


def _cosine(r: float, low: float) -> tuple[float, float]:
    """The cosine of a pair within pi / 4 of 0."""
    square, rest = two_product(r, r)
    sum = 0.0
    for term in COSINE:
        sum = sum * square + term
    half = 0.5 * square
    first = 1.0 - half
    return quick_sum(first, ((1.0 - first) - half) + (square * square * sum - 0.5 * rest - r * low))


def _reduced(x: float) -> tuple[int, float, float]:
    """The number of quarter turns of an angle (its last two bits count), and the remainder as a pair."""
    if abs(x) <= _SMALL:
        return 0, x, 0.0
    if abs(x) < _NEAR:
        return _near(x)
    quarter, high, low = _far(abs(x))
    if x < 0.0:
        return -quarter, -high, -low
    return quarter, high, low


def _near(x: float) -> tuple[int, float, float]:
    quarters = (x * TWO_OVER_PI + _ROUNDING) - _ROUNDING
    high, first = two_sum(x - quarters * QUARTER_1, -(quarters * QUARTER_2))
    high, second = two_sum(high, -(quarters * QUARTER_3))
    high, third = two_sum(high, -(quarters * QUARTER_4))
    high, low = two_sum(high, first + second + third)
    return int(quarters), high, low


def _far(x: float) -> tuple[int, float, float]:
    """x * 2 / pi by its digits of 28 bits from the units down; higher digits are whole turns."""
    word = bits_of_real(x)
    mantissa = word & 0xFFFFFFFFFFFFF | 0x10000000000000
    # x is mantissa * 2^shift * 2^-56, and the mantissa shifted by less than a digit has three digits.
    shift = (word >> 52) - 1075 + 56
    first = shift // 28
    rest = shift - 28 * first
    low = (mantissa & _DIGIT) << rest
    middle = ((mantissa >> 28) << rest) + (low >> 28)
    low = low & _DIGIT
    high = middle >> 28
    middle = middle & _DIGIT
    sixth = _column(first + 6, low, middle, high)
    fifth = _column(first + 5, low, middle, high) + (sixth >> 28)
    fourth = _column(first + 4, low, middle, high) + (fifth >> 28)
    third = _column(first + 3, low, middle, high) + (fourth >> 28)
    second = _column(first + 2, low, middle, high) + (third >> 28)
    next = _column(first + 1, low, middle, high) + (second >> 28)
    units = _column(first, low, middle, high) + (next >> 28)
    leading = next & _DIGIT
    if leading >= 0x8000000:
        leading = leading - 0x10000000
        units = units + 1
    turn, turn_low = two_sum(float(leading) * _FIRST, float(second & _DIGIT) * _SECOND)
    turn, turn_low = add(turn, turn_low, float(third & _DIGIT) * _THIRD, 0.0)
    turn, turn_low = add(turn, turn_low, float(fourth & _DIGIT) * _FOURTH, 0.0)
    turn, turn_low = add(turn, turn_low, float(fifth & _DIGIT) * _FIFTH, 0.0)
    turn, turn_low = add(turn, turn_low, float(sixth & _DIGIT) * _SIXTH, 0.0)
    turn, turn_low = multiply(turn, turn_low, HALF_PI, HALF_PI_LOW)
    return units & 3, turn, turn_low


def _column(at: int, low: int, middle: int, high: int) -> int:
    """One digit of the product, with its carry."""
    return (
        low * TWO_OVER_PI_DIGITS[at] + middle * TWO_OVER_PI_DIGITS[at + 1] + high * TWO_OVER_PI_DIGITS[at + 2]
    )
