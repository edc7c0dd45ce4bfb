"""Polygons and lines of a GeoJSON file (RFC 7946), by msgspec.

A feature's name is its property `name`, `Name` or `title`, else its `id`. Coordinates are longitude, latitude
and possibly an altitude; a `crs` other than WGS 84 is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec

from lfield.errors import MissionFileError
from lfield.geodata.mission_files import utf8_bytes
from lfield.geodata.shapes import Shape, checked_position

_GEOMETRIES = ("Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon")
TYPES = ("FeatureCollection", "Feature", "GeometryCollection", *_GEOMETRIES)
#: Names of WGS 84 in the member `crs` of GeoJSON before RFC 7946.
_WGS84 = ("CRS84", "EPSG::4326", "EPSG:4326")
_MAX_DEPTH = 20


def read_geojson(file: str, data: bytes) -> list[Shape]:
    """The shapes of all features. Raises MissionFileError."""
    try:
        tree = msgspec.json.decode(utf8_bytes(file, data))
    except (msgspec.DecodeError, RecursionError) as error:
        raise MissionFileError(file, f"not JSON: {error}") from None
    if not isinstance(tree, dict) or tree.get("type") not in TYPES:
        raise MissionFileError(file, f"it is not GeoJSON: its type is none of {', '.join(TYPES)}")
    crs = tree.get("crs")
    if crs is not None and not _name(crs).endswith(_WGS84):
        raise MissionFileError(
            file, f"its coordinate system is '{_name(crs)[:80]}'; lfield reads WGS 84 only"
        )
    return list(_Reader(file).features(tree))


def _name(crs: Any) -> str:
    properties = crs.get("properties") if isinstance(crs, dict) else None
    return str(properties.get("name")) if isinstance(properties, dict) else ""


class _Reader(msgspec.Struct):
    """Reads features one after the other; `number` counts them from 1."""

    file: str
    number: int = 0

    def features(self, tree: dict[str, Any]) -> Iterator[Shape]:
        if tree["type"] == "FeatureCollection":
            listed = tree.get("features")
            if not isinstance(listed, list):
                raise MissionFileError(self.file, "its FeatureCollection has no array 'features'")
            for each in listed:
                yield from self._feature(each)
        elif tree["type"] == "Feature":
            yield from self._feature(tree)
        else:
            self.number += 1
            yield from self._geometry(tree, "")

    def _feature(self, tree: Any) -> Iterator[Shape]:
        self.number += 1
        if not isinstance(tree, dict) or tree.get("type") != "Feature":
            raise self._error("it is not an object of the type Feature")
        properties = tree.get("properties")
        named = properties if isinstance(properties, dict) else {}
        name = next((named[key] for key in ("name", "Name", "title") if named.get(key)), tree.get("id"))
        geometry = tree.get("geometry")
        if geometry is not None:  # a feature without a place
            yield from self._geometry(geometry, "" if name is None else str(name)[:200])

    def _geometry(self, tree: Any, name: str, depth: int = 0) -> Iterator[Shape]:
        kind = tree.get("type") if isinstance(tree, dict) else None
        if kind == "GeometryCollection" and depth < _MAX_DEPTH:
            for each in self._array(tree.get("geometries")):
                yield from self._geometry(each, name, depth + 1)
            return
        if kind not in _GEOMETRIES:
            description = f"'{kind[:40]}'" if isinstance(kind, str) else "an object without a type"
            raise self._error(f"{description} is not a geometry")
        parts = tree.get("coordinates")
        for part in self._array(parts) if kind.startswith("Multi") else [parts]:
            yield self._shape(kind.removeprefix("Multi"), name, part)

    def _shape(self, kind: str, name: str, part: Any) -> Shape:
        if kind == "Point":
            corners, heights = self._corners([part])
            return Shape(self.number, name, "point", corners, 0, heights)
        if kind == "LineString":
            corners, heights = self._corners(part)
            return Shape(self.number, name, "line", corners, 0, heights)
        rings = self._array(part)
        corners, heights = self._corners(rings[0] if rings else [])
        if len(corners) > 1 and corners[0] == corners[-1]:
            corners = corners[:-1]
        return Shape(self.number, name, "polygon", corners, max(0, len(rings) - 1), heights)

    def _corners(self, part: Any) -> tuple[tuple[tuple[float, float], ...], bool]:
        corners, heights = [], False
        values = self._array(part)
        for value in values:
            try:
                numbers = msgspec.convert(value, list[float])
                if len(numbers) < 2:
                    raise ValueError
                corners.append(checked_position(numbers[1], numbers[0]))
            except (msgspec.ValidationError, ValueError):
                raise self._error(f"{str(value)[:60]} is not [longitude, latitude] in degrees") from None
            heights = heights or (len(numbers) > 2 and numbers[2] != 0.0)
        return tuple(corners), heights

    def _array(self, value: Any) -> list[Any]:
        if not isinstance(value, list):
            raise self._error("its coordinates are not an array")
        return value

    def _error(self, reason: str) -> MissionFileError:
        return MissionFileError(self.file, reason, where=f"feature {self.number}")
