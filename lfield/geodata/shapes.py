"""Shapes of map files, and the check whether they are usable areas.

An area for a vehicle is one simple polygon: it has no holes, does not cross itself, and is away from the
antimeridian and the poles, where a flat plane does not exist.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from msgspec import Struct

from lfield.errors import MissionFileError
from lfield.geodata.findings import FileFinding
from lfield.geodata.polygons import Position, area, crossing_edges, length, plane_of

#: The most corners of a shape; the check for crossings compares pairs of edges.
MAX_CORNERS = 4000
#: Degrees of latitude beyond which no area is used: a degree of longitude is shorter than 2 km there.
POLAR = 89.0
#: Square metres below which a polygon has no extent.
LEAST_AREA = 0.01


class Shape(Struct, frozen=True):
    """One polygon, line or point of a file. A polygon's last corner is not its first.

    `number` counts the placemarks or features of the file from 1. `holes` is the number of inner boundaries.
    """

    number: int
    name: str
    kind: str
    corners: tuple[Position, ...]
    holes: int = 0
    has_heights: bool = False

    @property
    def label(self) -> str:
        """`polygon 'north field'`, or `polygon 3` without a name."""
        return f"{self.kind} '{self.name}'" if self.name else f"{self.kind} {self.number}"

    @property
    def size(self) -> float:
        """Square metres of a polygon, metres of a line."""
        if not self.corners:
            return 0.0
        points = plane_of(self.corners).points(self.corners)
        return area(points) if self.kind == "polygon" else length(points)


def checked_position(latitude: float, longitude: float) -> tuple[float, float]:
    """Latitude and longitude in degrees. Raises ValueError, also for NaN."""
    if not (math.isfinite(latitude) and abs(latitude) <= 90.0):
        raise ValueError(f"latitude {latitude:g} is not between -90 and 90 degrees")
    if not (math.isfinite(longitude) and abs(longitude) <= 180.0):
        raise ValueError(f"longitude {longitude:g} is not between -180 and 180 degrees")
    return latitude, longitude


def chosen_shape(file: str, shapes: Sequence[Shape], name: str = "") -> Shape:
    """The polygon or line with a name; without a name the only one. Raises MissionFileError."""
    usable = [shape for shape in shapes if shape.kind != "point"]
    if not usable:
        raise MissionFileError(file, "it has no polygon and no line")
    found = [shape for shape in usable if name in (shape.name, str(shape.number))] if name else usable
    if len(found) == 1:
        return found[0]
    names = [shape.name for shape in usable]
    keys = (each.name if names.count(each.name) == 1 and each.name else each.number for each in usable[:20])
    listed = ", ".join(f"'{key}'" for key in keys)
    if not found:
        raise MissionFileError(file, f"it has no polygon or line '{name}'; it has {listed}")
    raise MissionFileError(
        file, f"it has {len(found)} polygons and lines; choose one by name or number: {listed}"
    )


def shape_findings(shape: Shape) -> list[FileFinding]:
    """The reasons why a shape is not usable as an area or line; empty if it is."""
    if (count := len(shape.corners)) > MAX_CORNERS:
        text = f"{shape.label} has {count} corners; at most {MAX_CORNERS} are permitted"
        return [FileFinding("M208", text)]
    findings = list(_position_findings(shape))
    if shape.kind == "polygon":
        findings += _polygon_findings(shape, is_flat=not findings)
    elif len(set(shape.corners)) < 2:
        findings.append(FileFinding("M201", f"{shape.label} has {_points(shape)}; a line has at least 2"))
    if shape.has_heights:
        findings.append(FileFinding("M903", f"{shape.label} has heights, which an area does not use"))
    return findings


def _position_findings(shape: Shape) -> list[FileFinding]:
    if any(abs(latitude) > POLAR for latitude, _ in shape.corners) or _encircles_pole(shape):
        return [FileFinding("M204", f"{shape.label} is at a pole")]
    edges = zip(shape.corners, [*shape.corners[1:], *shape.corners[:1]], strict=True)
    for number, (start, end) in enumerate(edges, 1):
        closes = number == len(shape.corners)
        if abs(end[1] - start[1]) > 180.0 and not (closes and shape.kind == "line"):
            text = f"{shape.label} crosses the antimeridian after corner {number}"
            return [FileFinding("M203", f"{text}; divide it there")]
    return []


def _encircles_pole(shape: Shape) -> bool:
    """Whether a polygon leads once around the Earth's axis."""
    if shape.kind != "polygon" or len(shape.corners) < 3:
        return False
    longitudes = [longitude for _, longitude in shape.corners]
    edges = zip(longitudes, [*longitudes[1:], *longitudes[:1]], strict=True)
    return abs(sum(math.remainder(end - start, 360.0) for start, end in edges)) > 180.0


def _polygon_findings(shape: Shape, *, is_flat: bool) -> list[FileFinding]:
    findings: list[FileFinding] = []
    if shape.holes:
        holes = "a hole" if shape.holes == 1 else f"{shape.holes} holes"
        findings.append(FileFinding("M205", f"{shape.label} has {holes}; divide it into areas without"))
    if len(set(shape.corners)) < 3:
        return [*findings, FileFinding("M201", f"{shape.label} has {_points(shape)}; an area has at least 3")]
    if not is_flat:
        return findings
    if (number := _repeated_corner(shape.corners)) is not None:
        text = f"{shape.label} has the corners {number} and {number + 1} at the same place; delete one"
        return [*findings, FileFinding("M209", text)]
    points = plane_of(shape.corners).points(shape.corners)
    if (crossing := crossing_edges(points)) is not None:
        first, second = (each + 1 for each in crossing)
        text = f"{shape.label} crosses itself: the edges after corner {first} and after corner {second}"
        findings.append(FileFinding("M202", text))
    elif area(points) < LEAST_AREA:
        findings.append(FileFinding("M206", f"{shape.label} has no extent: its corners are on one line"))
    return findings


def _repeated_corner(corners: Sequence[Position]) -> int | None:
    """The number of the first corner that equals the next one, from 1."""
    return next(
        (number for number, (first, second) in enumerate(pairwise(corners), 1) if first == second), None
    )


def _points(shape: Shape) -> str:
    count = len(set(shape.corners))
    return f"{count} different corner{'s' * (count != 1)}"
