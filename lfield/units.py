"""Units as data: the meanings of symbols, the parsing of compound units, and conversions between units.

A unit is written as in the manifests of drivers: factors with their exponents, `/` before divisors: `m/s`,
`m/s2`, `N m`, `kg m2/s2`. Numbers inside lfield are SI; other units are converted where they are read. An
angle has its own dimension, so that hertz are never converted to radians per second.
"""

from __future__ import annotations

import math
import re
from fractions import Fraction
from functools import lru_cache

from msgspec import Struct

from lfield.text.suggestions import did_you_mean

#: The base units in the order of the exponents: SI's base units, the radian, and the byte.
BASE = ("m", "kg", "s", "A", "K", "mol", "cd", "rad", "B")

#: Exponents of the base units, in the order of BASE.
Dimension = tuple[int, ...]


class MeasurementUnit(Struct, frozen=True):
    """A unit: `amount * factor + offset` is the amount in SI. The conversion is exact, except for multiples
    of pi.
    """

    dimension: Dimension
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)


#: The pure number: the unit of a ratio or a count, or no unit.
ONE = MeasurementUnit((0,) * len(BASE))

_DEGREE = Fraction(math.pi) / 180

#: The table of units: a symbol, its unit expressed in units above it, and the factor.
_TABLE: tuple[tuple[str, str, Fraction], ...] = (
    ("%", "", Fraction(1, 100)),
    ("ppm", "", Fraction(1, 10**6)),
    ("km", "m", Fraction(1000)),
    ("dm", "m", Fraction(1, 10)),
    ("cm", "m", Fraction(1, 100)),
    ("mm", "m", Fraction(1, 1000)),
    ("um", "m", Fraction(1, 10**6)),
    ("in", "m", Fraction(254, 10**4)),
    ("ft", "m", Fraction(3048, 10**4)),
    ("mi", "m", Fraction(1609344, 1000)),
    ("nmi", "m", Fraction(1852)),
    ("L", "m3", Fraction(1, 1000)),
    ("t", "kg", Fraction(1000)),
    ("g", "kg", Fraction(1, 1000)),
    ("mg", "kg", Fraction(1, 10**6)),
    ("lb", "kg", Fraction(45359237, 10**8)),
    ("ms", "s", Fraction(1, 1000)),
    ("us", "s", Fraction(1, 10**6)),
    ("min", "s", Fraction(60)),
    ("h", "s", Fraction(3600)),
    ("d", "s", Fraction(86400)),
    ("kn", "m/s", Fraction(1852, 3600)),
    ("mrad", "rad", Fraction(1, 1000)),
    ("deg", "rad", _DEGREE),
    ("°", "rad", _DEGREE),
    ("rev", "rad", _DEGREE * 360),
    ("rpm", "rad/s", _DEGREE * 6),
    ("Hz", "1/s", Fraction(1)),
    ("kHz", "Hz", Fraction(10**3)),
    ("MHz", "Hz", Fraction(10**6)),
    ("GHz", "Hz", Fraction(10**9)),
    ("N", "kg m/s2", Fraction(1)),
    ("kN", "N", Fraction(1000)),
    ("Pa", "N/m2", Fraction(1)),
    ("hPa", "Pa", Fraction(100)),
    ("kPa", "Pa", Fraction(1000)),
    ("MPa", "Pa", Fraction(10**6)),
    ("mbar", "Pa", Fraction(100)),
    ("bar", "Pa", Fraction(10**5)),
    ("J", "N m", Fraction(1)),
    ("kJ", "J", Fraction(1000)),
    ("Wh", "J", Fraction(3600)),
    ("kWh", "J", Fraction(3600000)),
    ("W", "J/s", Fraction(1)),
    ("mW", "W", Fraction(1, 1000)),
    ("kW", "W", Fraction(1000)),
    ("mA", "A", Fraction(1, 1000)),
    ("C", "A s", Fraction(1)),
    ("Ah", "C", Fraction(3600)),
    ("mAh", "C", Fraction(36, 10)),
    ("V", "W/A", Fraction(1)),
    ("mV", "V", Fraction(1, 1000)),
    ("kV", "V", Fraction(1000)),
    ("ohm", "V/A", Fraction(1)),
    ("T", "V s/m2", Fraction(1)),
    ("mT", "T", Fraction(1, 1000)),
    ("uT", "T", Fraction(1, 10**6)),
    ("lx", "cd/m2", Fraction(1)),
    ("kB", "B", Fraction(1000)),
    ("MB", "B", Fraction(10**6)),
    ("KiB", "B", Fraction(1 << 10)),
    ("MiB", "B", Fraction(1 << 20)),
    ("bit", "B", Fraction(1, 8)),
)

#: Scales with another zero: symbol, kelvins in one degree, kelvins at zero. Their symbols cannot be part of a
#: compound unit.
_SCALES: tuple[tuple[str, Fraction, Fraction], ...] = (
    ("degC", Fraction(1), Fraction(27315, 100)),
    ("°C", Fraction(1), Fraction(27315, 100)),
    ("degF", Fraction(5, 9), Fraction(45967, 100) * Fraction(5, 9)),
)

#: The units of the registry besides SI: places on the Earth are in degrees, temperatures in degrees Celsius.
EXTRA_UNITS = frozenset({"deg", "degC", "°C"})

_FACTOR = re.compile(r"(?P<symbol>[^\s/0-9^]+)\^?(?P<exponent>-?[0-9])?|1")
_LONGEST = 40


def unit(text: str) -> MeasurementUnit | None:
    """The unit that a text names, the pure number for '' and '1'; None if there is no such unit."""
    return _read(text.strip()) if len(text) <= _LONGEST else None


def is_unit(text: str) -> bool:
    """Whether a text names a unit."""
    return unit(text) is not None


def conversion(source: str, target: str) -> tuple[float, float] | None:
    """(factor, offset): `amount` in `source` is `amount * factor + offset` in `target`.

    None if one of them is no unit, or if they have different dimensions.
    """
    before, after = unit(source), unit(target)
    if before is None or after is None or before.dimension != after.dimension:
        return None
    return float(before.factor / after.factor), float((before.offset - after.offset) / after.factor)


def is_registry_unit(text: str) -> bool:
    """Whether values of the registry may be in it: SI without prefixes, or one of EXTRA_UNITS."""
    meant = unit(text)
    if meant is None:
        return False
    return text.strip() in EXTRA_UNITS or (meant.factor == 1 and meant.offset == 0)


def in_si(text: str) -> str:
    """The SI unit for the dimension of a unit, written with base units: `kg m/s2` for `kN`, '' for none."""
    meant = unit(text) or ONE
    pairs = list(zip(BASE, meant.dimension, strict=True))
    over = " ".join(base + _exponent(power) for base, power in pairs if power > 0)
    under = "".join(f"/{base}{_exponent(-power)}" for base, power in pairs if power < 0)
    return (over or "1") + under if over or under else ""


def suggestion(text: str) -> str:
    """A hint for a text that is not a unit."""
    return did_you_mean(text.strip()[:_LONGEST], _symbols()) or "write units like m, kg, m/s2, N m, rad/s"


def _exponent(power: int) -> str:
    return str(power) if power != 1 else ""


@lru_cache(maxsize=1)
def _symbols() -> dict[str, MeasurementUnit]:
    """All symbols of the tables. A row is parsed with the symbols of the rows above it."""
    symbols: dict[str, MeasurementUnit] = {}
    for index, base in enumerate(BASE):
        symbols[base] = MeasurementUnit(tuple(int(i == index) for i in range(len(BASE))))
    for symbol, meaning, amount in _TABLE:
        whole = _product(meaning, symbols)
        assert whole is not None, symbol
        symbols[symbol] = MeasurementUnit(whole.dimension, whole.factor * amount)
    for symbol, amount, zero in _SCALES:
        symbols[symbol] = MeasurementUnit(symbols["K"].dimension, amount, zero)
    return symbols


@lru_cache(maxsize=1024)
def _read(text: str) -> MeasurementUnit | None:
    symbols = _symbols()
    return symbols.get(text) or _product(text, symbols)


def _product(text: str, symbols: dict[str, MeasurementUnit]) -> MeasurementUnit | None:
    """`N m/s2`: words are multiplied; all factors after a `/` in the last word are divisors."""
    whole: MeasurementUnit | None = ONE
    factors = text.split()
    for index, factor in enumerate(factors):
        over, *under = factor.split("/")
        if under and index < len(factors) - 1:
            return None  # `J/kg K` is ambiguous: K may be above or below
        whole = _times(whole, _factor(over, symbols), 1)
        for divisor in under:
            whole = _times(whole, _factor(divisor, symbols), -1)
    return whole


def _factor(text: str, symbols: dict[str, MeasurementUnit]) -> MeasurementUnit | None:
    """`s2`: a symbol of the table with its exponent; `1` in front of a `/`."""
    match = _FACTOR.fullmatch(text)
    if match is None:
        return None
    if match["symbol"] is None:
        return ONE
    symbol = symbols.get(match["symbol"])
    if symbol is None or symbol.offset:
        return None
    return _times(ONE, symbol, int(match["exponent"] or 1))


def _times(left: MeasurementUnit | None, right: MeasurementUnit | None, power: int) -> MeasurementUnit | None:
    if left is None or right is None:
        return None
    exponents = zip(left.dimension, right.dimension, strict=True)
    return MeasurementUnit(tuple(a + b * power for a, b in exponents), left.factor * right.factor**power)
