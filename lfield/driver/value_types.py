"""Conversion and checking of values that pass between a program and a driver, by L type."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress

from lfield.manifest import DeviceValue

INT_MIN, INT_MAX = -(1 << 63), (1 << 63) - 1


#: Converts a value to an L type; integers widen to real. Raises ValueError.
ValueCheck = Callable[[object], DeviceValue]


def conform(value: object, type_name: str) -> DeviceValue:
    """Returns `value` as the L type; integers widen to real. Raises ValueError."""
    check = VALUE_CHECKS.get(type_name)
    if check is None:
        raise _unfit(value, type_name)
    return check(value)


def _unfit(value: object, type_name: str) -> ValueError:
    return ValueError(f"{value!r} is not a {type_name}")


def _boolean(value: object) -> DeviceValue:
    if isinstance(value, bool):
        return value
    raise _unfit(value, "boolean")


def _int(value: object) -> DeviceValue:
    if isinstance(value, int) and not isinstance(value, bool) and INT_MIN <= value <= INT_MAX:
        return value
    raise _unfit(value, "int")


def _real(value: object) -> DeviceValue:
    # Most telemetry consists of floats, which are checked first.
    if type(value) is float:
        return value
    if isinstance(value, int | float) and not isinstance(value, bool):
        with suppress(OverflowError):  # an integer that no real can represent
            return float(value)
    raise _unfit(value, "real")


def _string(value: object) -> DeviceValue:
    if isinstance(value, str):
        return value
    raise _unfit(value, "string")


def _void(value: object) -> DeviceValue:
    if value is None:
        return None
    raise _unfit(value, "void")


def _array(item: ValueCheck, type_name: str) -> ValueCheck:
    def check(value: object) -> DeviceValue:
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise _unfit(value, type_name)
        return [item(part) for part in value]  # type: ignore[misc]  # all int, or all float

    return check


def exceeds(values: Sequence[object], largest: float) -> bool:
    """Whether a finite real among the values, also in arrays, is larger than `largest` in magnitude."""
    for value in values:
        if isinstance(value, float):
            if largest < abs(value) < math.inf:
                return True
        elif isinstance(value, list) and exceeds(value, largest):
            return True
    return False


#: The function that `conform` uses for each type.
VALUE_CHECKS: dict[str, ValueCheck] = {
    "boolean": _boolean,
    "int": _int,
    "real": _real,
    "string": _string,
    "void": _void,
    "real[]": _array(_real, "real[]"),
    "int[]": _array(_int, "int[]"),
}
