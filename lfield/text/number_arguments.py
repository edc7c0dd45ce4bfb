"""Numeric types of argparse, whose errors state the valid range."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def real_between(minimum: float, maximum: float, unit: str = "") -> Callable[[str], float]:
    """A type of argparse: a number from `minimum` to `maximum`; `unit` is its unit, as in `seconds`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not minimum <= value <= maximum:
            raise _not_a_number(f"a number{_of_unit(unit)} from {minimum:.10g} to {maximum:.10g}", text)
        return value

    return read


def real_above_0(maximum: float, unit: str = "") -> Callable[[str], float]:
    """A type of argparse: a number above 0, and at most `maximum`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0.0 < value <= maximum:
            raise _not_a_number(f"a number{_of_unit(unit)} above 0 and at most {maximum:.10g}", text)
        return value

    return read


def whole_between(minimum: int, maximum: int, unit: str = "") -> Callable[[str], int]:
    """A type of argparse: a whole number from `minimum` to `maximum`."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = minimum - 1
        if not minimum <= value <= maximum:
            raise _not_a_number(f"a whole number{_of_unit(unit)} from {minimum} to {maximum}", text)
        return value

    return read


def _of_unit(unit: str) -> str:
    return f" of {unit}" if unit else ""


def _not_a_number(expected: str, text: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"must be {expected}, not '{text}'")
