"""Reads KML and GeoJSON files, which are detected from their first characters, and checks a shape."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Iterator

from lfield.geodata.findings import FileFinding
from lfield.geodata.geojson import TYPES, read_geojson
from lfield.geodata.kml import read_kml
from lfield.geodata.mission_files import PlanPoint, PlanReport, PlanRequest
from lfield.geodata.polygons import LocalPlane, length, plane_of
from lfield.geodata.shapes import Shape, shape_findings

_BOMS = (codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
#: The number of first characters that are searched for the format of a file.
_HEAD = 4096
_GEOJSON = re.compile(rb'"type"\s*:\s*"(%b)"' % "|".join(TYPES).encode())
_PLAN = re.compile(rb'"fileType"\s*:')


def is_area_file(name: str, data: bytes) -> bool:
    """Whether the bytes of a file are KML, KMZ or GeoJSON."""
    return is_kml(data) or _is_geojson(name, data)


def read_area_file(name: str, data: bytes) -> list[Shape]:
    """The shapes of the file. Raises MissionFileError."""
    return read_kml(name, data) if is_kml(data) else read_geojson(name, data)


def is_kml(data: bytes) -> bool:
    """Whether the bytes are XML, or a zip file."""
    head = data[:_HEAD]
    for mark in _BOMS:
        head = head.removeprefix(mark)
    return head.replace(b"\0", b"").lstrip().startswith((b"<", b"PK\x03\x04"))


def _is_geojson(name: str, data: bytes) -> bool:
    head = data[:_HEAD]
    if _PLAN.search(head):
        return False
    return name.lower().endswith(".geojson") or _GEOJSON.search(head) is not None


def check_shape(shape: Shape, request: PlanRequest) -> PlanReport:
    """The report about an area or a line; its corners count as items from 1."""
    is_area = shape.kind == "polygon"
    corners = shape.corners
    points = plane_of(corners).points(corners) if corners else []
    closed = [*points, *points[:1]] if is_area else points
    home = None if request.home is None else request.home[:2]
    distances = [] if home is None else [math.hypot(*LocalPlane(*home).point(each)) for each in corners]
    farthest = max(((distance, number) for number, distance in enumerate(distances, 1)), default=None)
    findings = [
        *shape_findings(shape),
        *_radius_findings(shape, distances, request.limits.get("radius", math.inf)),
    ]
    return PlanReport(
        tuple(findings),
        length=length(closed),
        extent=shape.size if is_area else 0.0,
        farthest=farthest,
        home=home,
        path=() if is_area else [PlanPoint(number, each, None) for number, each in enumerate(corners, 1)],
        areas=(corners,) if is_area else (),
    )


def _radius_findings(shape: Shape, distances: list[float], radius: float) -> Iterator[FileFinding]:
    for number, distance in enumerate(distances, 1):
        if distance > radius:
            corner = f"corner {number} of {shape.label}"
            text = f"{corner} is {distance:.1f} m from home, beyond the limit of {radius:g} m"
            yield FileFinding("M207", text, number)
