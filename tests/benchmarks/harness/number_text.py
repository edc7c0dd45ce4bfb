"""Numbers with units as text."""

from __future__ import annotations

#: Units of samples.
SECONDS, BYTES, PERCENT, COUNT, TIMES, RATE = "s", "B", "%", "messages", "x", "kB/s"


def number_text(number: float, unit: str) -> str:
    """A number with its unit, to about three digits."""
    if unit == SECONDS:
        return _seconds(number)
    if unit == BYTES:
        return f"{number / 1e6:.1f} MB" if number >= 1e6 else f"{number / 1e3:.1f} kB"
    if unit == TIMES:
        return times(number)
    return f"{number:g}" if unit == COUNT else f"{number:.2f} {unit}"


def times(ratio: float) -> str:
    """A ratio as text."""
    return f"{ratio:.2g}x" if abs(ratio) < 0.1 else f"{ratio:.2f}x" if abs(ratio) < 10 else f"{ratio:.0f}x"


def size(count: int) -> str:
    """A number of bytes as text."""
    return f"{count} B" if count < 1024 else f"{count // 1024} KiB"


def _seconds(seconds: float) -> str:
    for least, factor, unit in ((1.0, 1.0, "s"), (1e-3, 1e3, "ms"), (0.0, 1e6, "µs")):
        if abs(seconds) >= least:
            number = seconds * factor
            digits = 3 if abs(number) < 1 else 2 if abs(number) < 10 else 1 if abs(number) < 100 else 0
            return f"{number:.{digits}f} {unit}"
    return f"{seconds} s"
