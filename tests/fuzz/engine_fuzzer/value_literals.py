"""Values of L: usual ones, and limits of a type or a function."""

from __future__ import annotations

import random

from engine_fuzzer.program_tree import PLAIN

#: Usual numbers, which rarely cause exceptions.
_USUAL: dict[str, tuple[str, ...]] = {
    "int": ("0", "1", "2", "3", "5", "7", "(-1)", "(-3)", "100"),
    "real": ("0.0", "1.0", "0.5", "(-1.5)", "2.0", "3.0", "0.1", "7.25"),
    "boolean": ("true", "false"),
    "string": ('""', '"a"', '"ab"', '"größe"', '"12"', '"-7"', '"x y"'),
}
_INFINITY, _NAN = "(1e308 * 10.0)", "(1e308 * 10.0 - 1e308 * 10.0)"

#: Integers near 0, 32 bits, the largest exact integers of reals, roots, and the limits.
_INTS = (
    *("0", "1", "2", "3", "7", "(-1)", "(-2)", "(-7)", "17", "18", "64", "1000000"),
    *("2147483647", "2147483648", "(-2147483648)", "4294967295", "4294967296", "3037000499", "3037000500"),
    *("9007199254740991", "9007199254740992", "9007199254740993", "(-9007199254740993)"),
    *("999999999999999999", "1000000000000000000", "9223372036854775295", "9223372036854775296"),
    *("9223372036854775806", "9223372036854775807", "(-9223372036854775807)", "(-9223372036854775807 - 1)"),
)
#: Reals with special rounding, changes of sign, or two zeros; drawn more often than the others.
_ROUNDED = (
    *(
        "0.0",
        "(-0.0)",
        "0.5",
        "(-0.5)",
        "1.5",
        "(-1.5)",
        "2.5",
        "(-2.5)",
        "0.25",
        "(-0.75)",
        "(-0.9999999999)",
    ),
    *("0.49999999999999994", "(-0.49999999999999994)", "4503599627370495.5", "(-4503599627370495.5)"),
    *("4503599627370496.5", "9007199254740991.0", "9007199254740992.0", "(-9007199254740993.0)"),
)
#: Subnormal, smallest and largest reals, limits of ints, exponents and arcs, infinities, and NaN.
_REALS = (
    *_ROUNDED,
    *("1.0", "(-1.0)", "1.0000000000000002", "0.9999999999999999", "3.0", "(-3.0)", "10.0", "0.1", "(-0.1)"),
    *(
        "5e-324",
        "(-5e-324)",
        "1e-320",
        "2.225073858507201e-308",
        "2.2250738585072014e-308",
        "1e-300",
        "1e-17",
    ),
    *("1e16", "1e22", "1e23", "1e300", "1.7976931348623157e308", "(-1.7976931348623157e308)"),
    *(
        "9223372036854775807.0",
        "9223372036854774784.0",
        "(-9223372036854775808.0)",
        "(-9223372036854777856.0)",
    ),
    *("709.782712893384", "709.7827128933841", "(-745.1332191019411)", "(-745.1332191019412)", "1024.0"),
    *("1.5707963267948966", "3.141592653589793", "800000.0", "1e15", _INFINITY, f"(-{_INFINITY})", _NAN),
)
#: Texts of valid, invalid, and too large numbers.
_NUMERALS = (
    *("0", "-0", "+7", "-12", " 7 ", "\u2003-3\t", "007", "٣", "1_0", "", "-", "a", "null", "true"),
    *("999999999999999999", "-99999999999999999", "9223372036854775807", "9223372036854775808"),
    *("-9223372036854775808", "-9223372036854775809", "00000000000000000001"),
    *(
        "1.5e3",
        "-0.0",
        ".5",
        "5.",
        "1e400",
        "-1e-400",
        "5e-324",
        "1.7976931348623159e308",
        "inf",
        "nan",
        "0x1p3",
    ),
)
#: The first and last characters of 1, 2, 3 and 4 bytes, and characters on both sides of a new first byte.
_CHARACTERS = (
    *"\0a\x7f\x80\xbf\xc0ßö\u07ff\u0800\u0e01\u0fff\u1000\ud7ff\ue000\uffff",
    *"\U00010000\U0001f916\U0003ffff\U00040000\U000fffff\U00100000\U0010ffff",
)
_EDGES: dict[str, tuple[str, ...]] = {
    "int": _INTS,
    "real": _REALS,
    "boolean": _USUAL["boolean"],
}


def literal(rng: random.Random, kind: str) -> str:
    """A literal of a type, mostly a usual one; references have only the plain one."""
    if kind not in _USUAL:
        return PLAIN[kind]
    return rng.choice(_USUAL[kind]) if rng.random() < 0.75 else edge(rng, kind)


def edge(rng: random.Random, kind: str) -> str:
    """An edge value of int, real, boolean or string."""
    if kind == "real" and rng.random() < 0.3:
        return rng.choice(_ROUNDED)
    return _string(rng) if kind == "string" else rng.choice(_EDGES[kind])


def _string(rng: random.Random) -> str:
    """A numeral, or characters of a small alphabet, so that strings have common parts."""
    if rng.random() < 0.35:
        return written_text(rng.choice(_NUMERALS))
    alphabet = "b", *rng.sample(_CHARACTERS, 3)
    return written_text("".join(rng.choices(alphabet, k=rng.choice((1, 2, 3, 4, 7, 8, 9, 17)))))


def written_text(text: str) -> str:
    """A string as a literal of L."""
    plain = "".join(c if " " <= c < "\x7f" and c not in '"\\' else f"\\u{{{ord(c):X}}}" for c in text)
    return f'"{plain}"'
