"""Draws the tracks of a run: plan view, and heights over time if a device flies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import NamedTuple

from lfield.geodata.svg_canvas import COLOURS, LINE, MARGIN, Canvas, document, grid, text_at, text_width
from lfield.testing.mission.recorders import Point

#: Pixels: height of the strip with the heights.
STRIP = 120.0
#: Metres: minimum distance of drawn points; minimum height that counts as flying.
NEAR, FLIES = 0.03, 0.3


class Mark(NamedTuple):
    """An event: time in seconds; device, '' for none; a short text."""

    at: float
    device: str
    text: str


def draw(tracks: Mapping[str, Sequence[Point]], title: str, marks: Sequence[Mark] = ()) -> str:
    """An SVG of all tracks with points. Raises ValueError without any."""
    drawn = {name: points for name, points in tracks.items() if points}
    if not drawn:
        raise ValueError("no device has a known position")
    places = [(point.north, point.east) for points in drawn.values() for point in points]
    plan = Canvas(places, drawn)
    colours = dict(zip(drawn, cycle(COLOURS), strict=False))
    parts = [grid(plan)]
    parts += [_track(plan, points, colours[name]) for name, points in drawn.items()]
    parts += _names(plan, drawn, colours)
    parts += [_mark(plan, drawn[mark.device], mark) for mark in marks if mark.device in drawn]
    height = plan.height
    if max(point.up for points in drawn.values() for point in points) > FLIES:
        parts.append(_heights(plan, drawn, colours))
        height += STRIP
    captions = [f"{mark.at:.1f} s: {mark.text}" for mark in marks]
    parts += [text_at(MARGIN, height + LINE * (n + 1), line, "#555") for n, line in enumerate(captions)]
    height += LINE * (len(captions) + 1)
    title = title if text_width(title) < plan.width else title.partition(": ")[2] or title
    return document(plan.width, height, [text_at(MARGIN / 2, 24, title, "#222", weight="bold"), *parts])


def _track(plan: Canvas, points: Sequence[Point], colour: str) -> str:
    """A line from a ring to a disc."""
    places = [(plan.x(point.east), plan.y(point.north)) for point in _thinned(points)]
    (x0, y0), (x, y) = places[0], places[-1]
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in places)
    return (
        f'<path d="{path}" stroke="{colour}" stroke-width="2" stroke-linejoin="round" fill="none"/>\n'
        f'<circle cx="{x0:.1f}" cy="{y0:.1f}" r="5" stroke="{colour}" stroke-width="2" fill="#fff"/>\n'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}"/>'
    )


def _names(plan: Canvas, tracks: Mapping[str, Sequence[Point]], colours: Mapping[str, str]) -> list[str]:
    """The names beside the discs; names of devices that end at one position are stacked."""
    occupied: list[tuple[float, float, float]] = []
    texts = []
    for name, points in tracks.items():
        x, y = plan.x(points[-1].east) + 8, plan.y(points[-1].north) + 4
        end = x + text_width(name)
        while overlapping := [
            lower for left, right, lower in occupied if left < end and x < right and abs(y - lower) < LINE
        ]:
            y = max(overlapping) + LINE
        occupied.append((x, end, y))
        texts.append(text_at(x, y, name, colours[name]))
    return texts


def _thinned(points: Sequence[Point]) -> list[Point]:
    """The points without repeated ones."""
    distinct = [points[0]]
    for point in points[1:]:
        if math.hypot(point.north - distinct[-1].north, point.east - distinct[-1].east) > NEAR:
            distinct.append(point)
    return distinct


def _mark(plan: Canvas, points: Sequence[Point], mark: Mark) -> str:
    """A cross at the place where an event happened to a device."""
    point = min(points, key=lambda point: abs(point.at - mark.at))
    x, y = plan.x(point.east), plan.y(point.north)
    cross = f"M{x - 6:.1f} {y - 6:.1f}l12 12m0 -12l-12 12"
    return f'<path d="{cross}" stroke="#d00" stroke-width="3"/>'


def _heights(plan: Canvas, tracks: Mapping[str, Sequence[Point]], colours: Mapping[str, str]) -> str:
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
    lines.append(text_at(MARGIN, base + 14, f"height over {end:.0f} s, up to {top:.1f} m", "#888"))
    return "\n".join(lines)
