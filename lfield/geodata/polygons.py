"""Geometry of polygons and paths of a few kilometres, in metres on a local plane.

Latitudes and longitudes are projected onto a plane at their middle latitude (equirectangular), which is exact
enough for areas below 50 km. Self-intersection is found by a sweep over edges sorted by their west end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise

#: Metres of a degree of latitude on a sphere of the equatorial radius (WGS 84).
DEGREE = math.radians(6378137.0)
#: Corners of the polygon that represents a circle.
CIRCLE_CORNERS = 72
#: Latitude and longitude in degrees; metres east and north.
Position = tuple[float, float]
Point = tuple[float, float]


class LocalPlane:
    """Projects positions near an origin to metres east and north of it."""

    def __init__(self, latitude: float, longitude: float) -> None:
        self._latitude, self._longitude = latitude, longitude
        self._shrink = max(math.cos(math.radians(latitude)), 1e-6)

    def point(self, position: Position) -> Point:
        """Metres east and north."""
        latitude, longitude = position
        # The shortest difference, also across the antimeridian.
        east = math.remainder(longitude - self._longitude, 360.0) * DEGREE * self._shrink
        return (east, (latitude - self._latitude) * DEGREE)

    def position(self, point: Point) -> Position:
        """Latitude and longitude of metres east and north."""
        east, north = point
        longitude = self._longitude + east / (DEGREE * self._shrink)
        return (self._latitude + north / DEGREE, math.remainder(longitude, 360.0))

    def points(self, positions: Sequence[Position]) -> list[Point]:
        """Metres east and north of several positions."""
        return [self.point(position) for position in positions]


def plane_of(positions: Sequence[Position]) -> LocalPlane:
    """The plane at the middle of some positions. Raises ValueError without any."""
    latitudes = [latitude for latitude, _ in positions]
    longitudes = [longitude for _, longitude in positions]
    return LocalPlane((min(latitudes) + max(latitudes)) / 2.0, (min(longitudes) + max(longitudes)) / 2.0)


def circle(middle: Point, radius: float) -> list[Point]:
    """A circle as a polygon."""
    turns = (math.tau * step / CIRCLE_CORNERS for step in range(CIRCLE_CORNERS))
    return [(middle[0] + radius * math.sin(at), middle[1] + radius * math.cos(at)) for at in turns]


def edges(corners: Sequence[Point]) -> Iterator[tuple[Point, Point]]:
    """The edges of a closed polygon whose last corner is not its first."""
    return zip(corners, [*corners[1:], *corners[:1]], strict=True)


def area(corners: Sequence[Point]) -> float:
    """Area in square metres of a polygon that does not cross itself (shoelace formula)."""
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in edges(corners))) / 2.0


def length(points: Sequence[Point]) -> float:
    """Length of a path in metres."""
    return sum(math.dist(a, b) for a, b in pairwise(points))


def is_inside(corners: Sequence[Point], point: Point) -> bool:
    """Whether a point is inside a polygon (even-odd rule)."""
    x, y = point
    inside = False
    for (ax, ay), (bx, by) in edges(corners):
        if (ay > y) != (by > y) and x < (bx - ax) * (y - ay) / (by - ay) + ax:
            inside = not inside
    return inside


def crosses(corners: Sequence[Point], start: Point, end: Point) -> bool:
    """Whether the straight way between two points crosses or touches an edge of a polygon."""
    return any(_intersect(start, end, a, b) for a, b in edges(corners))


def distance_to_way(point: Point, start: Point, end: Point) -> float:
    """Distance in metres of a point from the straight way between two points."""
    dx, dy = end[0] - start[0], end[1] - start[1]
    square = dx * dx + dy * dy
    share = 0.0 if square == 0.0 else ((point[0] - start[0]) * dx + (point[1] - start[1]) * dy) / square
    share = min(1.0, max(0.0, share))
    return math.dist(point, (start[0] + share * dx, start[1] + share * dy))


def crossing_edges(corners: Sequence[Point]) -> tuple[int, int] | None:
    """Two edges of a polygon that cross or touch, by the number of their first corner from 0, or None.

    Neighbouring edges may share their corner, but must not lead back over each other.
    """
    count = len(corners)
    spans = [sum(abs(b[axis] - a[axis]) for a, b in edges(corners)) for axis in (0, 1)]
    # A sweep compares few pairs of edges that are short along its axis.
    ends = list(edges(corners if spans[0] <= spans[1] else [(y, x) for x, y in corners]))
    order = sorted(range(count), key=lambda each: min(ends[each][0][0], ends[each][1][0]))
    active: list[int] = []
    for each in order:
        a, b = ends[each]
        west = min(a[0], b[0])
        active = [second for second in active if max(ends[second][0][0], ends[second][1][0]) >= west]
        for second in active:
            if _conflict(each, second, count, ends):
                return (min(each, second), max(each, second))
        active.append(each)
    return None


def _conflict(first: int, second: int, count: int, ends: Sequence[tuple[Point, Point]]) -> bool:
    (a, b), (c, d) = ends[first], ends[second]
    if (first + 1) % count == second:
        return _leads_back(a, b, d)
    if (second + 1) % count == first:
        return _leads_back(c, d, b)
    return _intersect(a, b, c, d)


def _leads_back(a: Point, b: Point, c: Point) -> bool:
    """Whether the way from b to c lies on the way from a to b."""
    dot = (a[0] - b[0]) * (c[0] - b[0]) + (a[1] - b[1]) * (c[1] - b[1])
    return _turn(a, b, c) == 0.0 and dot > 0.0


def _intersect(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether two segments have a common point."""
    if max(a[1], b[1]) < min(c[1], d[1]) or max(c[1], d[1]) < min(a[1], b[1]):
        return False
    if max(a[0], b[0]) < min(c[0], d[0]) or max(c[0], d[0]) < min(a[0], b[0]):
        return False
    first, second = _turn(a, b, c), _turn(a, b, d)
    third, fourth = _turn(c, d, a), _turn(c, d, b)
    return first * second <= 0.0 and third * fourth <= 0.0


def _turn(a: Point, b: Point, c: Point) -> float:
    """A number above 0 if c is left of the way from a to b, below 0 if right."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
