"""Draws the tracks of a run: plan view, and heights over time if a device flies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from html import escape
from itertools import cycle
from typing import NamedTuple

from lfield.testing.mission.recorders import Point

#: Pixels: maximum of the plan's longer side, margin, height of the strip with the heights, text size, line
#: height; minimum width.
PLAN_SIZE, MARGIN, STRIP, TEXT, LINE, LEAST_WIDTH = 640.0, 48.0, 120.0, 12, 16, 480.0
#: Colours that are distinguishable with colour blindness (Okabe and Ito, 2008).
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#000000")
#: Metres: minimum distance of drawn points; minimum height that counts as flying; minimum extent.
NEAR, FLIES, LEAST = 0.03, 0.3, 4.0


class Mark(NamedTuple):
    """An event: time in seconds; device, '' for none; a short text."""

    at: float
    device: str
    text: str


class _Plan:
    """Converts metres to pixels: north is up. Reserves room on the right for the longest of some `names`."""

    def __init__(self, points: Sequence[Point], names: Iterable[str]) -> None:
        norths, easts = [p.north for p in points], [p.east for p in points]
        self.south, self.west = min(norths), min(easts)
        extent = max(max(norths) - self.south, max(easts) - self.west, LEAST)
        self.scale = PLAN_SIZE / extent
        label_width = MARGIN + max(map(_length, names))
        self.width = max(LEAST_WIDTH, (max(easts) - self.west) * self.scale + MARGIN + label_width)
        self.height = max(PLAN_SIZE / 5, (max(norths) - self.south) * self.scale) + 2 * MARGIN
        self.step = _round_step(extent / 5)

    def x(self, east: float) -> float:
        """Pixels from the left."""
        return MARGIN + (east - self.west) * self.scale

    def y(self, north: float) -> float:
        """Pixels from the top."""
        return self.height - MARGIN - (north - self.south) * self.scale


def draw(tracks: Mapping[str, Sequence[Point]], title: str, marks: Sequence[Mark] = ()) -> str:
    """An SVG of all tracks with points. Raises ValueError without any."""
    drawn = {name: points for name, points in tracks.items() if points}
    if not drawn:
        raise ValueError("no device has a known position")
    plan = _Plan([point for points in drawn.values() for point in points], drawn)
    colours = dict(zip(drawn, cycle(COLOURS), strict=False))
    parts = [_grid(plan)]
    parts += [_track(plan, points, colours[name]) for name, points in drawn.items()]
    parts += _names(plan, drawn, colours)
    parts += [_mark(plan, drawn[mark.device], mark) for mark in marks if mark.device in drawn]
    height = plan.height
    if max(point.up for points in drawn.values() for point in points) > FLIES:
        parts.append(_heights(plan, drawn, colours))
        height += STRIP
    captions = [f"{mark.at:.1f} s: {mark.text}" for mark in marks]
    parts += [_text(MARGIN, height + LINE * (n + 1), line, "#555") for n, line in enumerate(captions)]
    height += LINE * (len(captions) + 1)
    title = title if _length(title) < plan.width else title.partition(": ")[2] or title
    body = "\n".join([_text(MARGIN / 2, 24, title, "#222", weight="bold"), *parts])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {plan.width:.0f} {height:.0f}" '
        f'width="{plan.width:.0f}" font-family="sans-serif" font-size="{TEXT}">\n'
        f'<rect width="100%" height="100%" fill="#fff"/>\n{body}\n</svg>\n'
    )


def _grid(plan: _Plan) -> str:
    """Grid lines at whole metres, with their scale."""
    left, right, top, bottom = MARGIN / 2, plan.width - MARGIN / 2, MARGIN, plan.height - MARGIN / 2
    lines = []
    for east in _steps(plan.west, plan.step, plan.x, right):
        lines.append(f"M{plan.x(east):.1f} {top:.1f}V{bottom:.1f}")
    for north in _steps(plan.south, plan.step, lambda at: -plan.y(at), -top):
        lines.append(f"M{left:.1f} {plan.y(north):.1f}H{right:.1f}")
    scale = _text(left, bottom + 14, f"a square is {plan.step:g} m; north is up", "#888")
    return f'<path d="{"".join(lines)}" stroke="#e4e4e4" fill="none"/>\n{scale}'


def _steps(first: float, step: float, pixel: Callable[[float], float], last: float) -> list[float]:
    found, at = [], math.ceil(first / step) * step
    while pixel(at) <= last:
        found.append(at)
        at += step
    return found


def _track(plan: _Plan, points: Sequence[Point], colour: str) -> str:
    """A line from a ring to a disc."""
    places = [(plan.x(point.east), plan.y(point.north)) for point in _thinned(points)]
    (x0, y0), (x, y) = places[0], places[-1]
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in places)
    return (
        f'<path d="{path}" stroke="{colour}" stroke-width="2" stroke-linejoin="round" fill="none"/>\n'
        f'<circle cx="{x0:.1f}" cy="{y0:.1f}" r="5" stroke="{colour}" stroke-width="2" fill="#fff"/>\n'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>'
    )


def _names(plan: _Plan, tracks: Mapping[str, Sequence[Point]], colours: Mapping[str, str]) -> list[str]:
    """The names beside the discs; names of devices that end at one position are stacked."""
    occupied: list[tuple[float, float, float]] = []
    texts = []
    for name, points in tracks.items():
        x, y = plan.x(points[-1].east) + 8, plan.y(points[-1].north) + 4
        end = x + _length(name)
        while overlapping := [
            lower for left, right, lower in occupied if left < end and x < right and abs(y - lower) < LINE
        ]:
            y = max(overlapping) + LINE
        occupied.append((x, end, y))
        texts.append(_text(x, y, name, colours[name]))
    return texts


def _thinned(points: Sequence[Point]) -> list[Point]:
    """Without repeated points."""
    distinct = [points[0]]
    for point in points[1:]:
        if math.hypot(point.north - distinct[-1].north, point.east - distinct[-1].east) > NEAR:
            distinct.append(point)
    return distinct


def _mark(plan: _Plan, points: Sequence[Point], mark: Mark) -> str:
    """A cross where an event happened to a device."""
    point = min(points, key=lambda point: abs(point.at - mark.at))
    x, y = plan.x(point.east), plan.y(point.north)
    cross = f"M{x - 6:.1f} {y - 6:.1f}l12 12m0 -12l-12 12"
    return f'<path d="{cross}" stroke="#d00" stroke-width="3"/>'


def _heights(plan: _Plan, tracks: Mapping[str, Sequence[Point]], colours: Mapping[str, str]) -> str:
    """Height over time, below the plan."""
    end = max(points[-1].at for points in tracks.values()) or 1.0
    top = max(point.up for points in tracks.values() for point in points)
    width, base, tall = plan.width - 2 * MARGIN, plan.height + STRIP - 32, STRIP - 56
    lines = [f'<path d="M{MARGIN} {base:.1f}h{width:.1f}" stroke="#ccc"/>']
    for name, points in tracks.items():
        if max(point.up for point in points) > FLIES:
            places = (
                f"{MARGIN + point.at / end * width:.1f} {base - point.up / top * tall:.1f}"
                for point in points[::5]
            )
            lines.append(f'<path d="M{"L".join(places)}" stroke="{colours[name]}" fill="none"/>')
    lines.append(_text(MARGIN, base + 14, f"height over {end:.0f} s, up to {top:.1f} m", "#888"))
    return "\n".join(lines)


def _length(text: str) -> float:
    """Approximate width of a text in pixels."""
    return 0.6 * TEXT * len(text)


def _text(x: float, y: float, text: str, colour: str, weight: str = "normal") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" font-weight="{weight}">{escape(text)}</text>'


def _round_step(step: float) -> float:
    """1, 2 or 5 times a power of ten, rounded up."""
    power: float = 10.0 ** math.floor(math.log10(step))
    return next(power * digit for digit in (1, 2, 5, 10) if power * digit >= step)
