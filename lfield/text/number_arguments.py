"""Numeric types of argparse, whose errors state the valid range."""

from __future__ import annotations

import argparse
from collections.abc import Callable


def real_between(least: float, most: float, of: str = "") -> Callable[[str], float]:
    """A type of argparse: a number from `least` to `most`; `of` is its unit, as in `seconds`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= most:
            raise _not_a_number(f"a number{_of(of)} from {least:.10g} to {most:.10g}", text)
        return value

    return read


def real_above_0(most: float, of: str = "") -> Callable[[str], float]:
    """A type of argparse: a number above 0, and at most `most`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0.0 < value <= most:
            raise _not_a_number(f"a number{_of(of)} above 0 and at most {most:.10g}", text)
        return value

    return read


def whole_between(least: int, most: int, of: str = "") -> Callable[[str], int]:
    """A type of argparse: a whole number from `least` to `most`."""

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = least - 1
        if not least <= value <= most:
            raise _not_a_number(f"a whole number{_of(of)} from {least} to {most}", text)
        return value

    return read


def _of(of: str) -> str:
    return f" of {of}" if of else ""


def _not_a_number(what: str, text: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"must be {what}, not '{text}'")
