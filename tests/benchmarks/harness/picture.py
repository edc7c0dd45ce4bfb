"""Rows as a picture: cost over size for each figure with sizes, both axes logarithmic.

A point is the median; the thin line through it extends from the lowest to the highest sample. The factor
after each name is the growth of the cost with ten times the size. Equal rows give an equal picture.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

from harness.figure import GROWTH
from harness.number_text import SECONDS, number_text, times

#: Pixels of a field with its texts, of its plot, and of a line of text; fields in a row.
FIELD, PLOT_WIDTH, PLOT_HEIGHT, LINE, ACROSS = 470.0, 330.0, 190.0, 16.0, 2
#: Pixels from the corner of a field to the corner of its plot.
LEFT, TOP = 74.0, 58.0
#: Colours that are distinct for colour-blind people (Okabe and Ito, 2008).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#000000")


class Point(NamedTuple):
    """The cost of one size: least, median, greatest."""

    size: float
    least: float
    median: float
    greatest: float


class Pictured(NamedTuple):
    """A figure to draw: its title in the picture, the quantity of its sizes, and a filter of contender names.

    For a figure with several costs, `cost` selects the drawn one by the text after the colon of its cases.
    """

    title: str
    over: str
    lines: str = ""
    cost: str = ""


class Field(NamedTuple):
    """A figure's lines by contender, their unit and growths; `over` is the quantity of the sizes."""

    title: str
    over: str
    unit: str
    lines: Mapping[str, Sequence[Point]]
    growths: Mapping[str, float]


def draw(fields: Sequence[Field], about: str) -> str:
    """The SVG of the fields. Raises ValueError without fields."""
    if not fields:
        raise ValueError("none of these figures has sizes")
    parts, y = [], 44.0
    for start in range(0, len(fields), ACROSS):
        row = fields[start : start + ACROSS]
        parts += [_field(field, FIELD * i, y) for i, field in enumerate(row)]
        y += TOP + PLOT_HEIGHT + 40 + LINE * max(len(field.lines) for field in row)
    width = FIELD * min(ACROSS, len(fields))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {y:.0f}" width="{width:.0f}" '
        'font-family="sans-serif" font-size="12">\n<rect width="100%" height="100%" fill="#fff"/>\n'
        + "\n".join([_text(14, 26, about, "#222"), *parts])
        + "\n</svg>\n"
    )


def caption(about: Mapping[str, str]) -> str:
    """The first line of a picture: checkout and Python of its rows."""
    caption_text = f"make bench, lfield {about['checkout']}, Python {about['python']}"
    return f"{caption_text}: medians; thin lines from the least to the greatest sample"


def fields_of(rows: Sequence[Mapping[str, Any]], pictured: Mapping[str, Pictured]) -> list[Field]:
    """The fields of the picture of saved rows."""
    found = []
    for name, chosen in pictured.items():
        of_figure = [row for row in rows if row["figure"] == name and _is_pictured(row, chosen)]
        sized = [row for row in of_figure if row["size"]]
        lines: dict[str, list[Point]] = {}
        for row in sized:
            point = Point(row["size"], row["min"], row["median"], row["max"])
            lines.setdefault(row["measured"], []).append(point)
        growths = {row["measured"]: row["median"] for row in of_figure if row["case"].startswith(GROWTH)}
        plotted = {line: sorted(points) for line, points in lines.items() if len(points) > 1}
        if plotted:
            found.append(Field(chosen.title, chosen.over, sized[0]["unit"], plotted, growths))
    return found


def _is_pictured(row: Mapping[str, Any], chosen: Pictured) -> bool:
    cost = row["case"].partition(": ")[2]
    return not row["error"] and cost == chosen.cost and chosen.lines in row["measured"]


class _Axis:
    """A logarithmic axis from numbers to pixels."""

    def __init__(self, numbers: Sequence[float], length: float) -> None:
        self._low, self._high = math.log10(min(numbers)), math.log10(max(numbers))
        self._scale = length / ((self._high - self._low) or 1.0)

    def at(self, number: float) -> float:
        """Pixels from the start of the axis."""
        return (math.log10(number) - self._low) * self._scale

    def ticks(self) -> list[float]:
        """Powers of ten within the axis, or both ends if there are less than two."""
        powers = [10.0**n for n in range(math.ceil(self._low - 1e-9), math.floor(self._high + 1e-9) + 1)]
        return powers if len(powers) > 1 else [10.0**self._low, 10.0**self._high]


def _field(field: Field, left: float, top: float) -> str:
    points = [point for line in field.lines.values() for point in line]
    across = _Axis([point.size for point in points], PLOT_WIDTH)
    up = _Axis([cost for point in points for cost in (point.least, point.greatest)], PLOT_HEIGHT)
    x, y = left + LEFT, top + TOP + PLOT_HEIGHT - 30
    parts = [_text(left + 14, top + 12, field.title, "#222", "bold")]
    for size in across.ticks():
        parts.append(_rule(x + across.at(size), y, 0, -PLOT_HEIGHT))
        parts.append(_text(x + across.at(size), y + LINE, f"{size:,.0f}", "#666", anchor="middle"))
    for cost in up.ticks():
        parts.append(_rule(x, y - up.at(cost), PLOT_WIDTH, 0))
        parts.append(_text(x - 8, y - up.at(cost) + 4, _cost(cost, field.unit), "#666", anchor="end"))
    parts.append(_text(x + PLOT_WIDTH, y + 2 * LINE, field.over, "#666", anchor="end"))
    for i, (name, line) in enumerate(field.lines.items()):
        colour = COLOURS[i % len(COLOURS)]
        parts.append(_line([(x + across.at(p.size), y - up.at(p.median)) for p in line], colour))
        parts += [
            _span(x + across.at(p.size), y - up.at(p.least), y - up.at(p.greatest), colour) for p in line
        ]
        grown = f", ten times: {times(field.growths[name])}" if name in field.growths else ""
        parts.append(_text(x, y + LINE * (i + 3), name + grown, colour))
    return "\n".join(parts)


def _cost(cost: float, unit: str) -> str:
    """A number of an axis as text."""
    if unit != SECONDS:
        return number_text(cost, unit)
    for least, factor, name in ((1.0, 1.0, "s"), (1e-3, 1e3, "ms"), (0.0, 1e6, "µs")):
        if cost >= least * 0.999:
            return f"{cost * factor:.3g} {name}"
    return f"{cost:g} s"


def _line(places: Sequence[tuple[float, float]], colour: str) -> str:
    path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in places)
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>' for x, y in places)
    return f'<path d="{path}" stroke="{colour}" stroke-width="2" fill="none"/>\n{dots}'


def _span(x: float, low: float, high: float, colour: str) -> str:
    return f'<path d="M{x:.1f} {low:.1f}V{high:.1f}" stroke="{colour}" stroke-width="1"/>'


def _rule(x: float, y: float, across: float, up: float) -> str:
    return f'<path d="M{x:.1f} {y:.1f}l{across:.1f} {up:.1f}" stroke="#e4e4e4"/>'


def _text(x: float, y: float, label: str, colour: str, weight: str = "normal", anchor: str = "start") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-weight="{weight}" text-anchor="{anchor}">'
        f"{escape(label)}</text>"
    )
