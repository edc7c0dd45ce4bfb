"""Values that cross between a program and a driver: checked against their L type."""

from __future__ import annotations

from collections.abc import Sequence

from lfield.manifest import DeviceValue

INT_MIN, INT_MAX = -(1 << 63), (1 << 63) - 1


def conform(value: object, type_name: str) -> DeviceValue:
    """`value` as the L type; whole numbers widen to real. Raises ValueError with a sentence."""
    if type_name.endswith("[]"):
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise ValueError(f"{value!r} is not a {type_name}")
        items = [conform(item, type_name[:-2]) for item in value]
        return items  # type: ignore[return-value]  # items are all int or all float, by the line above
    fits = {
        "boolean": isinstance(value, bool),
        "int": isinstance(value, int) and not isinstance(value, bool) and INT_MIN <= value <= INT_MAX,
        "real": isinstance(value, int | float) and not isinstance(value, bool),
        "string": isinstance(value, str),
        "void": value is None,
    }
    if not fits.get(type_name, False):
        raise ValueError(f"{value!r} is not a {type_name}")
    return float(value) if type_name == "real" else value  # type: ignore[arg-type,return-value]  # as above
