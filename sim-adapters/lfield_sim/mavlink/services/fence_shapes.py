"""Shapes of an uploaded fence: inclusion and exclusion polygons and circles.

A position must be in one of the inclusion shapes, if any, and in no exclusion shape. Metres in the local
frame; pure geometry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct, field

from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.plans import BOUNDARY, NO_BREACH
from lfield_sim.mavlink.geo import GeoOrigin
from lfield_sim.mavlink.services.plan_items import CIRCLE_IN, CIRCLES, POLYGON_IN, POLYGONS, PlanItem

Point = tuple[float, float]


class FencePolygon(Struct, frozen=True):
    """At least three corners, the last joined to the first; it may be concave."""

    corners: tuple[Point, ...]
    include: bool

    def holds(self, point: Point) -> bool:
        """Whether a point is inside: a ray from it crosses the outline an odd number of times."""
        inside = False
        north, east = point
        for (north1, east1), (north2, east2) in zip(self.corners, self._next_corners(), strict=True):
            crosses = (east1 > east) != (east2 > east)
            if crosses and north < north1 + (east - east1) / (east2 - east1) * (north2 - north1):
                inside = not inside
        return inside

    def _next_corners(self) -> tuple[Point, ...]:
        return (*self.corners[1:], self.corners[0])


class FenceCircle(Struct, frozen=True):
    """A centre and a radius in metres."""

    centre: Point
    radius: float
    include: bool

    def holds(self, point: Point) -> bool:
        """Whether a point is inside."""
        return math.dist(point, self.centre) <= self.radius


FenceShape = FencePolygon | FenceCircle


class UploadedFence(Struct):
    """All shapes of a vehicle's fence; without any, everywhere is inside."""

    shapes: list[FenceShape] = field(default_factory=list)

    def breached(self, place: Vector) -> int:
        """The FENCE_BREACH of a place in the local frame."""
        point = place[:2]
        inclusions = [shape.holds(point) for shape in self.shapes if shape.include]
        excluded = any(shape.holds(point) for shape in self.shapes if not shape.include)
        return BOUNDARY if excluded or (inclusions and not any(inclusions)) else NO_BREACH


def shapes_of(items: Sequence[PlanItem], place: GeoOrigin) -> list[FenceShape]:
    """The shapes of checked items of a fence plan (MAV_CMD 5001 to 5004; a return point: none)."""
    shapes: list[FenceShape] = []
    number = 0
    while number < len(items):
        item = items[number]
        count = int(item.values[0]) if item.command in POLYGONS else 1
        if item.command in POLYGONS:
            corners = tuple(place.local(corner.x, corner.y) for corner in items[number : number + count])
            shapes.append(FencePolygon(corners, item.command == POLYGON_IN))
        elif item.command in CIRCLES:
            shapes.append(FenceCircle(place.local(item.x, item.y), item.values[0], item.command == CIRCLE_IN))
        number += count
    return shapes
