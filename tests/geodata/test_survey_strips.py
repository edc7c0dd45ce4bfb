"""Strips of a survey: the minimum number of strips that cover a polygon with the given spacing."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.geodata.polygons import LocalPlane, crossing_edges, distance_to_way, is_inside, plane_of
from lfield.geodata.survey_strips import MAX_STRIPS, strip_numbers, survey_strips

PLANE = LocalPlane(47.4, 8.5)


def degrees(points):
    return [PLANE.position(point) for point in points]


def square(width, height):
    return degrees([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])


@st.composite
def stars(draw):
    """Polygons without crossing edges, mostly concave: the corners have increasing angles around a point."""
    count = draw(st.integers(3, 12))
    radii = draw(st.lists(st.floats(5.0, 120.0), min_size=count, max_size=count))
    turn = draw(st.floats(0.0, 1.0))
    angles = [math.tau * (n + turn) / count for n in range(count)]
    return [(r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]


@given(stars(), st.floats(3.0, 60.0), st.floats(0.0, 359.0), st.randoms(use_true_random=False))
def test_each_point_is_within_half_a_spacing_of_a_strip(points, spacing, heading, rng):
    assert crossing_edges(points) is None
    corners = degrees(points)
    strips = survey_strips(corners, spacing, heading)
    plane = plane_of(corners)
    outline = plane.points(corners)
    lines = [(plane.point(strip.start), plane.point(strip.end)) for strip in strips]
    inside = outline + [
        point
        for point in ((rng.uniform(-120, 120), rng.uniform(-120, 120)) for _ in range(100))
        if is_inside(outline, point)
    ]
    for point in inside:
        assert min(distance_to_way(point, *line) for line in lines) <= spacing / 2 + 5e-3
    # All strips are parallel to the heading.
    for (x, y), (u, v) in lines:
        across = (u - x) * math.cos(math.radians(heading)) - (v - y) * math.sin(math.radians(heading))
        assert abs(across) < 1e-3


def test_field_of_60_by_40_metres_has_four_strips():
    strips = survey_strips(square(60.0, 40.0), 15.0, 0.0)
    lines = [(PLANE.point(strip.start), PLANE.point(strip.end)) for strip in strips]
    expected = [
        ((7.5, 0), (7.5, 40)),
        ((22.5, 40), (22.5, 0)),
        ((37.5, 0), (37.5, 40)),
        ((52.5, 40), (52.5, 0)),
    ]
    for line, expected_line in zip(lines, expected, strict=True):
        assert line[0] == pytest.approx(expected_line[0], abs=0.01)
        assert line[1] == pytest.approx(expected_line[1], abs=0.01)
    numbers = strip_numbers(strips)
    assert (len(numbers), tuple(numbers[2:4])) == (16, strips[0].end)
    assert [round(strip.length) for strip in survey_strips(square(60.0, 40.0), 15.0, 90.0)] == [60, 60, 60]


def test_notch_divides_strips():
    shape = [(0, 0), (60, 0), (60, 50), (40, 50), (40, 20), (20, 20), (20, 50), (0, 50)]
    lengths = [round(strip.length) for strip in survey_strips(degrees(shape), 10.0, 90.0)]
    assert lengths == [20, 20, 20, 20, 20, 20, 60, 60]


def test_area_narrower_than_the_spacing_has_one_strip():
    assert len(survey_strips(square(3.0, 40.0), 15.0, 0.0)) == 1


@pytest.mark.parametrize(
    ("spacing", "heading"),
    [
        (0.0, 0.0),
        (-1.0, 0.0),
        (math.nan, 0.0),
        (math.inf, 0.0),
        (1e6, 0.0),
        (5.0, 360.0),
        (5.0, -1.0),
        (5.0, math.nan),
    ],
)
def test_invalid_spacing_or_heading_is_refused(spacing, heading):
    with pytest.raises(ValueError, match="not"):
        survey_strips(square(60.0, 40.0), spacing, heading)


def test_too_many_strips_are_refused():
    with pytest.raises(ValueError, match=str(MAX_STRIPS)):
        survey_strips(square(60_000.0, 40.0), 1.0, 0.0)
