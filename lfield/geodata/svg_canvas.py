"""A map drawn as SVG: metres north and east to pixels, grid lines with their scale, texts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from html import escape

#: Pixels: maximum of the map's longer side, margin, text size, line height; minimum width.
PLAN_SIZE, MARGIN, TEXT, LINE, LEAST_WIDTH = 640.0, 48.0, 12, 16, 480.0
#: Metres: minimum extent.
LEAST = 4.0
#: Colours that are distinguishable with colour blindness (Okabe and Ito, 2008).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#000000")


class Canvas:
    """Converts metres to pixels: north is up. Reserves room on the right for the longest of some `names`.

    `places` are metres north and east.
    """

    def __init__(self, places: Sequence[tuple[float, float]], names: Iterable[str]) -> None:
        norths, easts = [north for north, _ in places], [east for _, east in places]
        self.south, self.west = min(norths), min(easts)
        extent = max(max(norths) - self.south, max(easts) - self.west, LEAST)
        self.scale = PLAN_SIZE / extent
        label_width = MARGIN + max(map(text_width, names))
        self.width = max(LEAST_WIDTH, (max(easts) - self.west) * self.scale + MARGIN + label_width)
        self.height = max(PLAN_SIZE / 5, (max(norths) - self.south) * self.scale) + 2 * MARGIN
        self.step = _round_step(extent / 5)

    def x(self, east: float) -> float:
        """Pixels from the left."""
        return MARGIN + (east - self.west) * self.scale

    def y(self, north: float) -> float:
        """Pixels from the top."""
        return self.height - MARGIN - (north - self.south) * self.scale


def document(width: float, height: float, parts: Iterable[str]) -> str:
    """The SVG of some elements on a white background."""
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" font-family="sans-serif" font-size="{TEXT}">\n'
        f'<rect width="100%" height="100%" fill="#fff"/>\n{body}\n</svg>\n'
    )


def grid(canvas: Canvas) -> str:
    """Grid lines at whole metres, with their scale."""
    left, right, top, bottom = MARGIN / 2, canvas.width - MARGIN / 2, MARGIN, canvas.height - MARGIN / 2
    lines = []
    for east in _steps(canvas.west, canvas.step, canvas.x, right):
        lines.append(f"M{canvas.x(east):.1f} {top:.1f}V{bottom:.1f}")
    for north in _steps(canvas.south, canvas.step, lambda at: -canvas.y(at), -top):
        lines.append(f"M{left:.1f} {canvas.y(north):.1f}H{right:.1f}")
    scale = text_at(left, bottom + 14, f"a square is {canvas.step:g} m; north is up", "#888")
    return f'<path d="{"".join(lines)}" stroke="#e4e4e4" fill="none"/>\n{scale}'


def text_at(x: float, y: float, text: str, colour: str, weight: str = "normal") -> str:
    """A text whose baseline begins at a pixel."""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-weight="{weight}">{escape(text)}</text>'


def text_width(text: str) -> float:
    """Approximate width of a text in pixels."""
    return 0.6 * TEXT * len(text)


def _steps(first: float, step: float, pixel: Callable[[float], float], last: float) -> list[float]:
    found, at = [], math.ceil(first / step) * step
    while pixel(at) <= last:
        found.append(at)
        at += step
    return found


def _round_step(step: float) -> float:
    """1, 2 or 5 times a power of ten, rounded up."""
    power: float = 10.0 ** math.floor(math.log10(step))
    return next(power * digit for digit in (1, 2, 5, 10) if power * digit >= step)
