"""The angle of a direction, and the arcs of sine and cosine (table J.9, decision 58)."""

from __future__ import annotations

from math import copysign

from lfield.vm.maths.constants import (
    ANGLES,
    ANGLES_LOW,
    ARC,
    HALF_PI,
    HALF_PI_LOW,
    INFINITY,
    PI,
    PI_LOW,
)
from lfield.vm.maths.double_doubles import add, divide, exponent, multiply, root, scaled, two_product, two_sum
from lfield.vm.memory.word_codec import NAN

#: Below this an arc sine equals its argument.
_TINY = 7.450580596923828e-09
#: If two sides differ by this many powers of two, the angle is that of the longer one.
_APART = 64


def asin(x: float) -> float:
    """The arc sine in radians; NaN outside -1 to 1."""
    if not abs(x) <= 1.0:
        return NAN
    if abs(x) < _TINY:
        return x
    if abs(x) == 1.0:
        return copysign(HALF_PI, x)
    other, other_low = _leg(x)
    high, low = _angle(abs(x), 0.0, other, other_low)
    return copysign(high + low, x)


def acos(x: float) -> float:
    """The arc cosine in radians; NaN outside -1 to 1."""
    if not abs(x) <= 1.0:
        return NAN
    if abs(x) == 1.0:
        return 0.0 if x > 0.0 else PI
    other, other_low = _leg(x)
    high, low = _angle(other, other_low, abs(x), 0.0)
    if x < 0.0:
        high, low = add(PI, PI_LOW, -high, -low)
    return high + low


def atan2(y: float, x: float) -> float:
    """The angle of the direction (x, y) from the x axis, from -pi to pi; signed zeros count."""
    if x != x or y != y:
        return NAN
    if y == 0.0 or abs(x) == INFINITY:
        return _along(y, x)
    if x == 0.0 or abs(y) == INFINITY:
        return copysign(HALF_PI, y)
    apart = exponent(y) - exponent(x)
    if apart > _APART:
        return copysign(HALF_PI, y)
    if apart < -_APART:
        return y / x if x > 0.0 else copysign(PI, y)
    scale = -exponent(y) if apart > 0 else -exponent(x)
    high, low = _angle(scaled(abs(y), scale), 0.0, scaled(abs(x), scale), 0.0)
    if x < 0.0:
        high, low = add(PI, PI_LOW, -high, -low)
    return copysign(high + low, y)


def _along(y: float, x: float) -> float:
    """The angle of a direction along the x axis, or of a direction to an end of the axis."""
    if abs(y) == INFINITY:
        return copysign(0.5 * HALF_PI if x > 0.0 else 1.5 * HALF_PI, y)
    return copysign(PI, y) if copysign(1.0, x) < 0.0 else copysign(0.0, y)


def _leg(x: float) -> tuple[float, float]:
    """The root of 1 - x^2, within -1 to 1."""
    less, less_low = two_sum(1.0, -x)
    more, more_low = two_sum(1.0, x)
    square, square_low = multiply(less, less_low, more, more_low)
    return root(square, square_low)


def _angle(y: float, y_low: float, x: float, x_low: float) -> tuple[float, float]:
    """The angle of a direction in the first quadrant, as a pair."""
    if y > x:
        high, low = _arc(*divide(x, x_low, y, y_low))
        return add(HALF_PI, HALF_PI_LOW, -high, -low)
    return _arc(*divide(y, y_low, x, x_low))


def _arc(t: float, t_low: float) -> tuple[float, float]:
    """The arc tangent of a pair from 0 to 1: the nearest eighth plus the remainder."""
    eighths = int(t * 8.0 + 0.5)
    if eighths > 0:
        near = float(eighths) * 0.125
        above, above_low = two_sum(t - near, t_low)
        below, below_low = two_product(near, t)
        below, below_low = add(1.0, 0.0, below, below_low + near * t_low)
        t, t_low = divide(above, above_low, below, below_low)
    square = t * t
    sum = 0.0
    for term in ARC:
        sum = sum * square + term
    return add(ANGLES[eighths], ANGLES_LOW[eighths], t, t_low + t * square * sum)
