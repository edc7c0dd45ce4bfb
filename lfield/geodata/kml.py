"""Polygons and lines of a KML file (OGC 12-007r2), by the XML parser of Python (expat), as a stream.

A document type declaration is refused, since entities are defined there. All namespaces of KML are accepted,
also none. Every coordinate that is not a position is an error: none is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from xml.parsers import expat

from msgspec import Struct, field

from lfield.errors import MissionFileError
from lfield.geodata.mission_files import ascii_number
from lfield.geodata.shapes import Shape, checked_position

#: Elements that may be in each other.
MAX_DEPTH = 200
_COMMA = re.compile(r"\s*,\s*")
_KINDS = {"Polygon": "polygon", "LineString": "line", "LinearRing": "polygon", "Point": "point"}


def read_kml(file: str, data: bytes) -> list[Shape]:
    """The shapes of all placemarks. Raises MissionFileError."""
    if data.startswith(b"PK"):
        raise MissionFileError(file, "it is a compressed KMZ; unzip it, and name the KML file in it")
    reader = _KmlReader(file)
    parser = expat.ParserCreate(namespace_separator=" ")
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = reader.start, reader.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = reader.text, reader.doctype
    reader.line = lambda: parser.CurrentLineNumber
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise MissionFileError(file, f"not XML: {reason}", where=f"line {error.lineno}") from None
    except (ValueError, LookupError) as error:  # an encoding that Python does not have
        raise MissionFileError(file, f"not XML: {error}") from None
    if not reader.is_kml:
        raise MissionFileError(file, "it is not KML: it has no element kml, Document, Folder or Placemark")
    return reader.shapes


class _Geometry(Struct):
    """A geometry while it is read."""

    kind: str
    corners: list[tuple[float, float]] = field(default_factory=list)
    holes: int = 0
    has_heights: bool = False


class _KmlReader:
    """Collects shapes from the events of the parser."""

    def __init__(self, file: str) -> None:
        self.shapes: list[Shape] = []
        self.is_kml = False
        #: The current line of the parser.
        self.line: Callable[[], int] = lambda: 0
        self._file, self._path = file, list[str]()
        self._pieces: list[str] = []
        self._name, self._placemarks = "", 0
        self._found: list[_Geometry] = []

    def doctype(self, *_: object) -> None:
        raise self._error("a document type declaration (DOCTYPE) is not permitted")

    def start(self, tag: str, _: object) -> None:
        name = tag.rpartition(" ")[2]
        if len(self._path) >= MAX_DEPTH:
            raise self._error(f"more than {MAX_DEPTH} elements are in each other")
        if not self._path:
            self.is_kml = name in ("kml", "Document", "Folder", "Placemark")
        if name == "Placemark":
            self._placemarks += 1
            self._name, self._found = "", []
        elif name in _KINDS and not (name == "LinearRing" and "Polygon" in self._path):
            self._found.append(_Geometry(_KINDS[name]))
        elif name == "innerBoundaryIs" and self._found:
            self._found[-1].holes += 1
        self._path.append(name)
        self._pieces = []

    def text(self, piece: str) -> None:
        if self._path and self._path[-1] in ("name", "coordinates"):
            self._pieces.append(piece)

    def end(self, _: str) -> None:
        name = self._path.pop()
        within = self._path[-1] if self._path else ""
        if name == "name" and within == "Placemark":
            self._name = "".join(self._pieces).strip()
        elif name == "coordinates" and self._found and "innerBoundaryIs" not in self._path:
            self._add_coordinates("".join(self._pieces))
        elif name == "Placemark":
            self._add_shapes()
        self._pieces = []

    def _add_coordinates(self, text: str) -> None:
        geometry = self._found[-1]
        for each in _COMMA.sub(",", text).split():
            parts = each.split(",")
            try:
                numbers = [ascii_number(part) for part in parts]
                if not 2 <= len(numbers) <= 3:
                    raise ValueError
                geometry.corners.append(checked_position(numbers[1], numbers[0]))
            except ValueError:
                reason = f"'{each[:60]}' is not longitude,latitude or longitude,latitude,altitude in degrees"
                raise self._error(reason) from None
            geometry.has_heights |= len(numbers) == 3 and numbers[2] != 0.0

    def _add_shapes(self) -> None:
        for geometry in self._found:
            corners = geometry.corners
            if geometry.kind == "polygon" and len(corners) > 1 and corners[0] == corners[-1]:
                corners = corners[:-1]
            shape = Shape(
                number=self._placemarks,
                name=self._name,
                kind=geometry.kind,
                corners=tuple(corners),
                holes=geometry.holes,
                has_heights=geometry.has_heights,
            )
            self.shapes.append(shape)
        self._found = []

    def _error(self, reason: str) -> MissionFileError:
        return MissionFileError(self._file, reason, where=f"line {self.line()}")
