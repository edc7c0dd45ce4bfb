"""Geometry on a plane: measures of a square, and crossing edges compared with a check of all pairs."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.geodata.polygons import (
    LocalPlane,
    area,
    crosses,
    crossing_edges,
    distance_to_way,
    edges,
    is_inside,
    length,
    plane_of,
)

SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
POINTS = st.tuples(st.integers(0, 12).map(float), st.integers(0, 12).map(float))


def test_plane_coordinates_are_metres_east_and_north():
    plane = LocalPlane(47.0, 179.999)
    east, north = plane.point((47.001, -179.999))
    assert north == pytest.approx(111.3, abs=0.1)
    assert east == pytest.approx(2 * 111.3 * math.cos(math.radians(47.0)), abs=0.2)
    assert plane_of([(47.0, 8.0), (47.2, 8.2)]).point((47.1, 8.1)) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_area_length_and_distances_of_a_square():
    assert area(SQUARE) == 100.0
    assert length(SQUARE) == 30.0
    assert is_inside(SQUARE, (5.0, 5.0))
    assert not is_inside(SQUARE, (15.0, 5.0))
    assert crosses(SQUARE, (5.0, 5.0), (15.0, 5.0))
    assert not crosses(SQUARE, (1.0, 1.0), (9.0, 9.0))
    assert distance_to_way((5.0, 3.0), (0.0, 0.0), (10.0, 0.0)) == 3.0
    assert distance_to_way((13.0, 4.0), (0.0, 0.0), (10.0, 0.0)) == 5.0
    assert distance_to_way((3.0, 4.0), (0.0, 0.0), (0.0, 0.0)) == 5.0


@given(st.lists(POINTS, min_size=3, max_size=9, unique=True))
def test_sweep_equals_the_comparison_of_all_pairs(corners):
    count, sides = len(corners), list(edges(corners))

    def touch(one, other):
        """Whether two edges have a common point other than their common corner."""
        (a, b), (c, d) = sides[one], sides[other]
        common = {a, b} & {c, d}
        if common:
            (corner,) = common
            ends = [next(p for p in pair if p != corner) for pair in ((a, b), (c, d))]
            (x, y), (u, v) = ((p[0] - corner[0], p[1] - corner[1]) for p in ends)
            return x * v == y * u and x * u + y * v > 0
        return _segments_meet(a, b, c, d)

    expected = any(touch(*pair) for pair in itertools.combinations(range(count), 2))
    assert (crossing_edges(corners) is not None) == expected


def _segments_meet(a, b, c, d):
    """Whether the segments ab and cd have a common point. Exact for integer coordinates."""

    def side(p, q, r):
        value = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        return (value > 0) - (value < 0)

    def within(p, q, r):
        return min(p[0], q[0]) <= r[0] <= max(p[0], q[0]) and min(p[1], q[1]) <= r[1] <= max(p[1], q[1])

    if side(a, b, c) != side(a, b, d) and side(c, d, a) != side(c, d, b):
        return True
    return any(
        side(p, q, r) == 0 and within(p, q, r) for p, q, r in ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    )
