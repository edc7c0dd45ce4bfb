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


def duration_in_words(seconds: float) -> str:
    """A short span of time: `0.4 ms`, `214 ms`, `1.2 s`."""
    if seconds >= 1.0:
        return f"{seconds:.1f} s"
    return f"{seconds * 1e3:.{0 if seconds >= 0.01 else 1}f} ms"


def share_in_words(share: float) -> str:
    """A part of a whole: `4.8 %`."""
    return f"{share * 100:.1f} %"


def bytes_in_words(count: int) -> str:
    """A number of bytes in units of 1,000: `310 B`, `12.3 kB`, `1.4 MB`."""
    if count < 1000:
        return f"{count} B"
    return f"{count / 1e3:.1f} kB" if count < 1e6 else f"{count / 1e6:.1f} MB"
