"""Drawings for a map on a screen: the lines and points of mission and area files, in degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import msgspec
from msgspec import Struct

from lfield.geodata.area_file import check_shape, read_area_file
from lfield.geodata.mission_files import PlanReport, PlanRequest, PlanZone, Position
from lfield.geodata.polygons import LocalPlane, circle
from lfield.geodata.shapes import Shape

#: The most corners of all drawings of a file: a browser draws all of them again when the map moves.
MAX_DRAWN = 20_000


class MapDrawing(Struct, frozen=True):
    """One line, closed line or group of points of the file `name`; circles are polygons.

    `way` and `rally` have a number for each point.
    """

    kind: Literal["way", "area", "inside", "outside", "rally", "home"]
    name: str
    points: tuple[Position, ...]
    numbers: tuple[int, ...] = ()


def drawings_of(name: str, report: PlanReport) -> list[MapDrawing]:
    """The drawings of a plan or area; at most `MAX_DRAWN` points, of the first drawings."""
    found, count = [], 0
    for drawing in _drawings(name, report):
        count += len(drawing.points)
        if count <= MAX_DRAWN and drawing.points:
            found.append(drawing)
    return found


def area_drawings(name: str, data: bytes) -> list[MapDrawing]:
    """The drawings of all polygons and lines of a KML or GeoJSON file. Raises MissionFileError."""
    shapes = [shape for shape in read_area_file(name, data) if shape.kind != "point"]
    reports = (check_shape(shape, PlanRequest()) for shape in shapes)
    return [drawing for report in reports if report.is_usable for drawing in drawings_of(name, report)]


def area_text(shapes: Sequence[Shape]) -> str:
    """Polygons as one GeoJSON text."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": shape.name},
            "geometry": {"type": "Polygon", "coordinates": [_ring(shape)]},
        }
        for shape in shapes
    ]
    return msgspec.json.encode({"type": "FeatureCollection", "features": features}).decode()


def _ring(shape: Shape) -> list[tuple[float, float]]:
    corners = [(longitude, latitude) for latitude, longitude in shape.corners]
    return [*corners, *corners[:1]]


def _drawings(name: str, report: PlanReport) -> Iterator[MapDrawing]:
    for area in report.areas:
        yield MapDrawing("area", name, tuple(area))
    for zone in report.zones:
        yield MapDrawing("inside" if zone.inclusion else "outside", name, _outline(zone))
    path = report.path
    yield MapDrawing(
        "way", name, tuple(point.position for point in path), tuple(point.item for point in path)
    )
    yield MapDrawing("rally", name, tuple(report.rally), tuple(range(1, len(report.rally) + 1)))
    if report.home is not None:
        yield MapDrawing("home", name, (report.home,))


def _outline(zone: PlanZone) -> tuple[Position, ...]:
    if len(zone.corners) != 1:
        return zone.corners
    plane = LocalPlane(*zone.corners[0])
    return tuple(plane.position(point) for point in circle((0.0, 0.0), zone.radius))
