"""Parallel strips that cover a polygon: the ways of a survey. Pure.

The plane is cut into bands as wide as the spacing. In each band the polygon is a row of trapezoids between
its edges and corners; a strip is the middle line of the band along trapezoids that touch. So every point of
the polygon, also of a concave one, is within half a spacing of a strip, between its ends.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

from msgspec import Struct

from lfield.geodata.polygons import Point, Position, edges, plane_of

#: Limits of the spacing in metres, and of the strips of a survey.
MIN_SPACING, MAX_SPACING, MAX_STRIPS = 0.5, 10_000.0, 1000
#: Metres at the edges of bands that are not covered, and below which two trapezoids touch: for rounding.
_TOLERANCE = 1e-3


class SurveyStrip(Struct, frozen=True):
    """The straight way from `start` to `end`, latitude and longitude in degrees; `length` in metres."""

    start: Position
    end: Position
    length: float


def survey_strips(corners: Sequence[Position], spacing: float, heading: float) -> list[SurveyStrip]:
    """The strips of a polygon in order, `spacing` metres apart, `heading` in degrees clockwise from north.

    Strips of neighbouring bands lead in opposite directions. Raises ValueError for invalid values.
    """
    if not MIN_SPACING <= spacing <= MAX_SPACING:
        raise ValueError(f"a spacing is from {MIN_SPACING:g} to {MAX_SPACING:g} m, not {spacing:g} m")
    if not 0.0 <= heading < 360.0:
        raise ValueError(f"a heading is from 0 to below 360 degrees, not {heading:g}")
    plane = plane_of(corners)
    turn = math.radians(heading)
    points = [_turned(point, turn) for point in plane.points(corners)]
    strips = []
    for number, (along, across) in enumerate(_bands(points, spacing)):
        if number % 2:
            along = [(end, start) for start, end in reversed(along)]
        for start, end in along:
            first, last = (plane.position(_turned((across, each), -turn)) for each in (start, end))
            strips.append(SurveyStrip(first, last, abs(end - start)))
            if len(strips) > MAX_STRIPS:
                raise ValueError(f"a spacing of {spacing:g} m makes more than {MAX_STRIPS} strips")
    return strips


def strip_numbers(strips: Sequence[SurveyStrip]) -> list[float]:
    """Latitude and longitude of start and end of each strip: four numbers each, for an array of L."""
    return [value for strip in strips for position in (strip.start, strip.end) for value in position]


def _turned(point: Point, turn: float) -> Point:
    """Metres across and along a heading; and back, with the heading negated."""
    (x, y), sine, cosine = point, math.sin(turn), math.cos(turn)
    return (x * cosine - y * sine, x * sine + y * cosine)


def _bands(points: Sequence[Point], spacing: float) -> Iterator[tuple[list[Point], float]]:
    """For each band the intervals along it, and its middle across."""
    low, high = min(x for x, _ in points), max(x for x, _ in points)
    count = max(1, math.ceil((high - low - _TOLERANCE) / spacing))
    if count > MAX_STRIPS:
        raise ValueError(f"a spacing of {spacing:g} m makes more than {MAX_STRIPS} strips")
    # The bands have a common middle with the polygon.
    first = (low + high - count * spacing) / 2.0
    for number in range(count):
        west = first + number * spacing
        along = _intervals(points, west + _TOLERANCE, west + spacing - _TOLERANCE)
        if along:
            yield along, west + spacing / 2.0


def _intervals(points: Sequence[Point], west: float, east: float) -> list[Point]:
    """The intervals along a band that the polygon has in it, from south to north."""
    cuts = sorted({west, east, *(x for x, _ in points if west < x < east)})
    crossing = [(a, b) for a, b in edges(points) if min(a[0], b[0]) < east and max(a[0], b[0]) > west]
    found: list[Point] = []
    for left, right in pairwise(cuts):
        found += _trapezoids(crossing, left, right)
    merged: list[Point] = []
    for low, high in sorted(found):
        if merged and low <= merged[-1][1] + _TOLERANCE:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return merged


def _trapezoids(crossing: Sequence[tuple[Point, Point]], left: float, right: float) -> Iterator[Point]:
    """The extent along the band of each trapezoid between two cuts, without a corner inside."""
    lines = []
    for a, b in crossing:
        if min(a[0], b[0]) <= left and max(a[0], b[0]) >= right and a[0] != b[0]:
            slope = (b[1] - a[1]) / (b[0] - a[0])
            ends = a[1] + slope * (left - a[0]), a[1] + slope * (right - a[0])
            lines.append((sum(ends), min(ends), max(ends)))
    lines.sort()
    for (_, low, _), (_, _, high) in zip(lines[::2], lines[1::2], strict=False):
        yield (low, high)
