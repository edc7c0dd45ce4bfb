"""Values that cross between a program and a driver: checked against their L type."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from lfield.manifest import DeviceValue

INT_MIN, INT_MAX = -(1 << 63), (1 << 63) - 1


#: Gives a value as an L type; whole numbers widen to real. Raises ValueError with a sentence.
Check = Callable[[object], DeviceValue]


def conform(value: object, type_name: str) -> DeviceValue:
    """`value` as the L type; whole numbers widen to real. Raises ValueError with a sentence."""
    check = CHECKS.get(type_name)
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
    # Telemetry is mostly floats, and there is a lot of it: the first look is the cheapest.
    if type(value) is float:
        return value
    if isinstance(value, int | float) and not isinstance(value, bool):
        with suppress(OverflowError):  # a whole number that no real can hold
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


def _array(item: Check, type_name: str) -> Check:
    def check(value: object) -> DeviceValue:
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise _unfit(value, type_name)
        return [item(part) for part in value]  # type: ignore[misc]  # all int, or all float

    return check


#: What `conform` does for each type, for those who ask for the same types again and again.
CHECKS: dict[str, Check] = {
    "boolean": _boolean,
    "int": _int,
    "real": _real,
    "string": _string,
    "void": _void,
    "real[]": _array(_real, "real[]"),
    "int[]": _array(_int, "int[]"),
}
