"""Values of devices in words, for people: short, and never more exact than anybody can read at a glance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

#: So many quantities of a device are shown, the first of its manifest.
SHOWN = 8
#: From here on a number is told by three digits and a power of ten: nobody counts ten digits.
LARGE = 1e6

Shown = bool | int | float | str | Sequence[int | float]


def in_words(value: Shown) -> str:
    """One value: `yes`, `4.20`, `-1.79e09`, `(1.00 2.00)`."""
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.2f}" if not abs(value) >= LARGE else f"{value:.3g}".replace("e+", "e")
        case int() | str():
            return str(value)
        case _:
            return f"({' '.join(in_words(part) for part in value)})"


def telemetry_in_words(values: Mapping[str, Shown | None], most: int = SHOWN) -> str:
    """The first quantities that have a value, and how many more there are: `armed yes, mode LAND`."""
    known = [f"{name} {in_words(value)}" for name, value in values.items() if value is not None]
    more = [f"and {len(known) - most} more"] if len(known) > most else []
    return ", ".join([*known[:most], *more])
