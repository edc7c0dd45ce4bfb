"""Values of devices as short text for people, rounded so that they can be read quickly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

#: The maximum number of quantities that are shown of a device: the first ones of its manifest.
MAX_SHOWN = 8
#: Numbers of at least this size are shown with three digits and a power of ten.
SCIENTIFIC_FROM = 1e6

ShownValue = bool | int | float | str | Sequence[int | float]


def value_text(value: ShownValue) -> str:
    """One value: `yes`, `4.20`, `-1.79e09`, `(1.00 2.00)`; never `-0.00`."""
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:z.2f}" if not abs(value) >= SCIENTIFIC_FROM else f"{value:.3g}".replace("e+", "e")
        case int() | str():
            return str(value)
        case _:
            return f"({' '.join(value_text(part) for part in value)})"


def telemetry_text(values: Mapping[str, ShownValue | None], limit: int = MAX_SHOWN) -> str:
    """The first quantities that have a value, and the number of others: `armed yes, mode LAND`."""
    known = [f"{name} {value_text(value)}" for name, value in values.items() if value is not None]
    more = [f"and {len(known) - limit} more"] if len(known) > limit else []
    return ", ".join([*known[:limit], *more])


def duration_text(seconds: float) -> str:
    """A short duration: `0.4 ms`, `214 ms`, `1.2 s`."""
    if seconds >= 1.0:
        return f"{seconds:.1f} s"
    return f"{seconds * 1e3:.{0 if seconds >= 0.01 else 1}f} ms"


def percentage_text(share: float) -> str:
    """A fraction as percentage: `4.8 %`."""
    return f"{share * 100:.1f} %"


def byte_count_text(count: int) -> str:
    """A number of bytes in units of 1,000: `310 B`, `12.3 kB`, `1.4 MB`."""
    if count < 1000:
        return f"{count} B"
    return f"{count / 1e3:.1f} kB" if count < 1e6 else f"{count / 1e6:.1f} MB"
