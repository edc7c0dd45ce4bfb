"""The shapes of a fence: inside and outside, by examples and by property."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.services.fence_shapes import (
    BOUNDARY,
    NO_BREACH,
    FenceCircle,
    FencePolygon,
    UploadedFence,
    shapes_of,
)
from lfield_sim.mavlink.services.plan_items import PlanItem

SQUARE = ((-10.0, -10.0), (-10.0, 10.0), (10.0, 10.0), (10.0, -10.0))
#: An L: its notch is the north-east quarter.
ELL = ((-10.0, -10.0), (-10.0, 10.0), (0.0, 10.0), (0.0, 0.0), (10.0, 0.0), (10.0, -10.0))


def test_fence_without_shapes_has_no_breach():
    assert UploadedFence().breached((1e6, -1e6, -500.0)) == NO_BREACH


@pytest.mark.parametrize(
    ("point", "inside"),
    [((0, 0), True), ((9.9, -9.9), True), ((10.1, 0), False), ((0, -10.1), False), ((-20, 10), False)],
)
def test_square_inclusion_and_exclusion(point, inside):
    assert FencePolygon(SQUARE, True).holds(point) is inside
    assert UploadedFence([FencePolygon(SQUARE, True)]).breached((*point, -5.0)) == (
        NO_BREACH if inside else BOUNDARY
    )
    assert UploadedFence([FencePolygon(SQUARE, False)]).breached((*point, -5.0)) == (
        BOUNDARY if inside else NO_BREACH
    )


def test_notch_of_a_polygon_is_outside():
    ell = FencePolygon(ELL, True)
    assert ell.holds((5.0, -5.0))
    assert ell.holds((-5.0, 5.0))
    assert not ell.holds((5.0, 5.0))


def test_one_inclusion_suffices_and_one_exclusion_breaches():
    fence = UploadedFence(
        [
            FenceCircle((0.0, 0.0), 5.0, True),
            FenceCircle((20.0, 0.0), 5.0, True),
            FenceCircle((2.0, 0.0), 1.0, False),
        ]
    )
    assert fence.breached((0.0, 0.0, 0.0)) == NO_BREACH
    assert fence.breached((18.0, 0.0, 0.0)) == NO_BREACH
    assert fence.breached((10.0, 0.0, 0.0)) == BOUNDARY
    assert fence.breached((2.0, 0.5, 0.0)) == BOUNDARY


angles = st.floats(0.0, math.tau)


@given(st.integers(3, 12), st.floats(5.0, 100.0), angles, st.floats(0.0, 200.0), angles)
def test_regular_polygon_lies_between_its_two_circles(sides, radius, turn, far, course):
    corners = [turn + math.tau * n / sides for n in range(sides)]
    polygon = FencePolygon(tuple((radius * math.cos(a), radius * math.sin(a)) for a in corners), True)
    point = (far * math.cos(course), far * math.sin(course))
    if far < radius * math.cos(math.pi / sides) - 1e-6:
        assert polygon.holds(point)
    if far > radius + 1e-6:
        assert not polygon.holds(point)


def test_fence_items_are_converted_to_shapes():
    place = GeoOrigin()
    items = [PlanItem(5001, 0, (4.0, 0, 0, 0), *place.at(*point)) for point in SQUARE]
    items.append(PlanItem(5000, 0, (0.0, 0, 0, 0), *place.at(0.0, 0.0)))
    items.append(PlanItem(5004, 0, (3.0, 0, 0, 0), *place.at(5.0, 5.0)))
    polygon, circle = shapes_of(items, place)
    assert isinstance(polygon, FencePolygon)
    assert [c == pytest.approx(e, abs=0.02) for c, e in zip(polygon.corners, SQUARE, strict=True)] == [
        True
    ] * 4
    assert isinstance(circle, FenceCircle)
    assert (circle.radius, circle.include) == (3.0, False)
    fence = UploadedFence([polygon, circle])
    assert fence.breached((0.0, 0.0, -3.0)) == NO_BREACH
    assert fence.breached((5.0, 5.0, -3.0)) == BOUNDARY
