"""Double-double arithmetic (Knuth, Dekker, Veltkamp): a pair is the unevaluated sum of two reals.

The basis of the maths of L (decision 58). It uses the four operations, square roots and bits only, which are
identical on every computer. This folder is written in the subset of Python that
`lfield/vm/wasm/lowering/maths_lowering.py` lowers to WebAssembly: reals, ints within 64 bits, `if`, `while`,
`for` over a constant table, and functions with one or several results.
"""

from __future__ import annotations

from math import sqrt

from lfield.vm.memory.word_codec import bits_of_real, real_from_bits

#: Splits a real into two halves of 26 bits.
_CUT = 134217729.0


def two_sum(a: float, b: float) -> tuple[float, float]:
    """The sum of any two reals, as a pair."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


def quick_sum(a: float, b: float) -> tuple[float, float]:
    """The sum of two reals as a pair; the first is not the smaller one (or is 0)."""
    total = a + b
    return total, b - (total - a)


def two_product(a: float, b: float) -> tuple[float, float]:
    """The product of two reals, as a pair; both below 2^996, and the product not near the smallest reals."""
    product = a * b
    cut = _CUT * a
    a_high = cut - (cut - a)
    a_low = a - a_high
    cut = _CUT * b
    b_high = cut - (cut - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


def add(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """The sum of two pairs."""
    high, rest = two_sum(a, b)
    low, last = two_sum(a_low, b_low)
    high, rest = quick_sum(high, rest + low)
    return quick_sum(high, rest + last)


def multiply(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """The product of two pairs."""
    high, rest = two_product(a, b)
    return quick_sum(high, rest + (a * b_low + a_low * b))


def divide(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """The quotient of two pairs; the second is not 0."""
    quotient = a / b
    high, low = two_product(quotient, b)
    rest = ((a - high) - low + a_low) - quotient * b_low
    return quick_sum(quotient, rest / b)


def root(a: float, a_low: float) -> tuple[float, float]:
    """The square root of a pair above 0."""
    first = sqrt(a)
    high, low = two_product(first, first)
    rest = ((a - high) - low) + a_low
    return quick_sum(first, rest / (first + first))


def exponent(x: float) -> int:
    """The binary exponent of a finite real, -1023 for 0 and subnormals."""
    return ((bits_of_real(x) >> 52) & 2047) - 1023


def scaled(x: float, power: int) -> float:
    """x times 2^power, rounded once; for x around 1 and powers from -1100 to 1100, or an exact result."""
    half = power >> 1
    return x * real_from_bits((half + 1023) << 52) * real_from_bits((power - half + 1023) << 52)
