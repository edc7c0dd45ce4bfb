"""Python that the maths of L may not use."""

from __future__ import annotations


def power(x: float) -> float:
    return x**2.0


def mixed(x: float) -> float:
    return x + 1


def number_as_condition(x: float) -> float:
    if x:
        return x
    return 1.0


def two_types(x: float) -> float:
    y = 1
    y = x
    return y


def unknown(x: float) -> float:
    return sorted((x, 1.0))[0]
