"""Constants of the maths of L: pi, ln 2, series coefficients, angles (decision 58).

A name with _LOW is the rounding error of the real before it. Coefficients are those of the plain series, the
last one first, as many as the reduced arguments need.
"""

from __future__ import annotations

from fractions import Fraction
from math import factorial, inf


def _hex(*digits: str) -> tuple[float, ...]:
    return tuple(float.fromhex(number) for number in digits)


INFINITY = inf

PI, PI_LOW = _hex("0x1.921fb54442d18p+1", "0x1.1a62633145c07p-53")
HALF_PI, HALF_PI_LOW = _hex("0x1.921fb54442d18p+0", "0x1.1a62633145c07p-54")
TWO_OVER_PI = float.fromhex("0x1.45f306dc9c883p-1")
#: pi / 2 in three parts of 33 bits and a remainder: a product of 20 bits with one of the parts is exact.
QUARTER_1, QUARTER_2, QUARTER_3, QUARTER_4 = _hex(
    "0x1.921fb54400000p+0", "0x1.0b4611a600000p-34", "0x1.3198a2e000000p-69", "0x1.b839a252049c1p-104"
)
#: 2 / pi in digits of 28 bits, after three digits 0.
TWO_OVER_PI_DIGITS = (
    *(0x0000000, 0x0000000, 0x0000000, 0xA2F9836, 0xE4E4415, 0x29FC275, 0x7D1F534, 0xDDC0DB6, 0x295993C),
    *(0x439041F, 0xE5163AB, 0xDEBBC56, 0x1B7246E, 0x3A424DD, 0x2E00649, 0x2EEA09D, 0x1921CFE, 0x1DEB1CB),
    *(0x129A73E, 0xE88235F, 0x52EBB44, 0x84E99C7, 0x026B45F, 0x7E41399, 0x1D63983, 0x5339F49, 0xC845F8B),
    *(0xBDF9283, 0xB1FF897, 0xFFDE059, 0x80FEF2F, 0x118B5A0, 0xA6D1F6D, 0x367ECF2, 0x7CB09B7, 0x4F463F6),
    *(0x69E5FEA, 0x2D7527B, 0xAC7EBE5, 0xF17B3D0, 0x739F78A, 0x5292EA6, 0xBFB5FB1, 0x1F8D5D0, 0x8560330),
)

#: ln 2: 40 bits, exact when multiplied by an exponent, and the remainder.
LN2, LN2_LOW = _hex("0x1.62e42fefa2000p-1", "0x1.9ef35793c7673p-41")
ONE_OVER_LN2 = float.fromhex("0x1.71547652b82fep+0")
THIRD, THIRD_LOW = _hex("0x1.5555555555555p-2", "0x1.5555555555555p-56")
FIFTH, FIFTH_LOW = _hex("0x1.999999999999ap-3", "-0x1.999999999999ap-57")


def _series(*terms: Fraction) -> tuple[float, ...]:
    return tuple(float(term) for term in reversed(terms))


#: sin x = x + x^3 S(x^2) and cos x = 1 - x^2 / 2 + x^4 C(x^2), up to pi / 4.
SINE = _series(*(Fraction((-1) ** n, factorial(2 * n + 1)) for n in range(1, 9)))
COSINE = _series(*(Fraction((-1) ** n, factorial(2 * n)) for n in range(2, 10)))
#: e^x = 1 + x + x^2 E(x), up to half of ln 2.
EXPONENTIAL = _series(*(Fraction(1, factorial(n)) for n in range(2, 15)))
#: ln((1 + s) / (1 - s)) = 2 (s + s^3 / 3 + s^5 / 5 + s^7 L(s^2)), up to 0.172.
LOGARITHM = _series(*(Fraction(1, 2 * n + 1) for n in range(3, 14)))
#: atan x = x + x^3 A(x^2), up to 1 / 16.
ARC = _series(*(Fraction((-1) ** n, 2 * n + 1) for n in range(1, 9)))
#: The angles whose tangents are 0, 1/8, 2/8 ... 1.
ANGLES = _hex(
    *(
        "0x0.0p+0",
        "0x1.fd5ba9aac2f6ep-4",
        "0x1.f5b75f92c80ddp-3",
        "0x1.6f61941e4def1p-2",
        "0x1.dac670561bb4fp-2",
    ),
    *("0x1.1e00babdefeb4p-1", "0x1.4978fa3269ee1p-1", "0x1.700a7c5784634p-1", "0x1.921fb54442d18p-1"),
)
ANGLES_LOW = _hex(
    *("0x0.0p+0", "-0x1.cd37686760c17p-59", "0x1.8ab6e3cf7afbdp-57", "-0x1.c63aae6f6e918p-56"),
    *("0x1.a2b7f222f65e2p-56", "-0x1.928df287a668fp-58", "0x1.2419a87f2a458p-56", "-0x1.8c34d25aadef6p-56"),
    "0x1.1a62633145c07p-55",
)
