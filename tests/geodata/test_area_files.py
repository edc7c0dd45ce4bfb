"""KML and GeoJSON: accepted files, and the errors of invalid files and areas."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfield.errors import MissionFileError
from lfield.geodata.area_file import is_area_file, read_area_file
from lfield.geodata.shapes import MAX_CORNERS, chosen_shape, shape_findings

SQUARE = "8.5,47.3,0 8.51,47.3,0 8.51,47.31,0 8.5,47.31,0 8.5,47.3,0"
CORNERS = ((47.3, 8.5), (47.3, 8.51), (47.31, 8.51), (47.31, 8.5))
RING = "<LinearRing><coordinates>{}</coordinates></LinearRing>"
OUTER = f"<Polygon><outerBoundaryIs>{RING}</outerBoundaryIs>{{}}</Polygon>"
INNER = f"<innerBoundaryIs>{RING}</innerBoundaryIs>"


def kml(*geometries, head="<kml xmlns='http://www.opengis.net/kml/2.2'>", prologue="<?xml version='1.0'?>"):
    marks = "".join(f"<Placemark><name>p{n}</name>{each}</Placemark>" for n, each in enumerate(geometries, 1))
    return f"{prologue}{head}<Document><name>doc</name>{marks}</Document></kml>".encode()


def polygon(coordinates=SQUARE, inner=""):
    return OUTER.format(coordinates, inner)


def geojson(geometry, **properties):
    feature = {"type": "Feature", "properties": properties, "geometry": geometry}
    return json.dumps({"type": "FeatureCollection", "features": [feature]}).encode()


def ring(*corners):
    return {"type": "Polygon", "coordinates": [[list(corner) for corner in (*corners, corners[0])]]}


def read(data, name="f.kml"):
    return read_area_file(name, data)


def codes(data):
    (shape,) = read(data)
    return [finding.code for finding in shape_findings(shape)]


# -- accepted files ----------------------------------------------------------------------------------------


def test_polygon_is_read_from_kml():
    (shape,) = read(kml(polygon()))
    assert (shape.name, shape.kind, shape.corners, shape.holes) == ("p1", "polygon", CORNERS, 0)
    assert not shape.has_heights
    assert shape_findings(shape) == []
    assert shape.size == pytest.approx(754.6 * 1113.2, rel=0.01)


@pytest.mark.parametrize(
    "data",
    [
        kml(polygon(), head="<kml>"),
        kml(polygon(), head="<kml xmlns='http://earth.google.com/kml/2.1'>"),
        kml(polygon(SQUARE.replace(",", " , ").replace(" 0 ", " 0\r\n\t"))),
        b"\xef\xbb\xbf" + kml(polygon()),
        kml(polygon()).decode().encode("utf-16"),
        kml(polygon(), prologue="<?xml version='1.0' encoding='ISO-8859-1'?>"),
        kml(f"<MultiGeometry>{polygon()}</MultiGeometry>"),
        kml("<LinearRing><coordinates>" + SQUARE + "</coordinates></LinearRing>"),
        kml(polygon()).replace(b"<Placemark>", b"<Folder><Folder><Placemark>").replace(
            b"</Placemark>", b"</Placemark></Folder></Folder>"
        ),
        geojson(ring(*((east, north) for north, east in CORNERS)), name="p1"),
        json.dumps(ring(*((east, north) for north, east in CORNERS))).encode(),
        b"\xef\xbb\xbf" + geojson(ring(*((east, north) for north, east in CORNERS))),
    ],
)  # fmt: skip
def test_notations_of_the_same_polygon_have_the_same_corners(data):
    (shape,) = read(data)
    assert shape.corners == CORNERS
    assert shape_findings(shape) == []


def test_lines_points_and_multi_geometries_are_read_as_single_shapes():
    line = "<LineString><coordinates>8,47 8.1,47</coordinates></LineString>"
    point = "<Point><coordinates>8,47,3</coordinates></Point>"
    shapes = read(kml(f"<MultiGeometry>{line}{point}</MultiGeometry>", line))
    assert [(shape.kind, shape.number) for shape in shapes] == [("line", 1), ("point", 1), ("line", 2)]
    many = {"type": "MultiPolygon", "coordinates": [ring((8, 47), (9, 47), (9, 48))["coordinates"]] * 2}
    points = {"type": "MultiPoint", "coordinates": [[8, 47], [9, 48]]}
    lines = {"type": "MultiLineString", "coordinates": [[[8, 47], [9, 48]]]}
    collection = {"type": "GeometryCollection", "geometries": [many, points, lines]}
    kinds = [shape.kind for shape in read(geojson(collection))]
    assert kinds == ["polygon", "polygon", "point", "point", "line"]
    assert read(geojson(None)) == []


def test_shape_is_selected_by_name_or_number():
    shapes = read(kml(polygon(), "<Point><coordinates>8,47</coordinates></Point>", polygon()))
    assert chosen_shape("f", shapes, "p3").number == 3
    assert chosen_shape("f", shapes, "1").name == "p1"
    for name in ("", "p2", "p9"):
        with pytest.raises(MissionFileError) as error:
            chosen_shape("f", shapes, name)
        assert "'p1', 'p3'" in error.value.fault
    with pytest.raises(MissionFileError):
        chosen_shape("f", [shapes[1]])
    assert chosen_shape("f", shapes[:2]).name == "p1"
    same = read(kml(polygon(), polygon()).replace(b"p2", b"p1"))
    with pytest.raises(MissionFileError) as error:
        chosen_shape("f", same, "p1")
    assert error.value.fault.endswith("'1', '2'")
    assert chosen_shape("f", same, "2").number == 2


def test_area_files_are_recognised():
    assert is_area_file("a.txt", kml(polygon()))
    assert is_area_file("a.kml", kml(polygon()).decode().encode("utf-16"))
    assert is_area_file("a", geojson(None))
    assert not is_area_file("a.plan", b'{"fileType": "Plan", "mission": {"items": [{"type": "Polygon"}]}}')
    assert not is_area_file("a.waypoints", b"QGC WPL 110\n")


# -- invalid areas ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("corners", "code"),
    [
        ([(8.0, 47.0), (8.1, 47.0)], "M201"),
        ([(8.0, 47.0), (8.1, 47.0), (8.0, 47.0)], "M201"),
        ([(8.0, 47.0), (8.1, 47.1), (8.1, 47.0), (8.0, 47.1)], "M202"),
        # A spike: two edges on the same line.
        ([(8.0, 47.0), (8.2, 47.0), (8.1, 47.0), (8.1, 47.1)], "M202"),
        # A corner on an edge between two other corners.
        ([(8.0, 47.0), (8.2, 47.0), (8.2, 47.1), (8.1, 47.0), (8.0, 47.1)], "M202"),
        ([(179.9, 10.0), (-179.9, 10.0), (-179.9, 11.0), (179.9, 11.0)], "M203"),
        ([(0.0, 80.0), (90.0, 80.0), (180.0, 80.0), (-90.0, 80.0)], "M204"),
        ([(0.0, -80.0), (-90.0, -80.0), (-180.0, -80.0), (90.0, -80.0)], "M204"),
        ([(0.0, 89.5), (1.0, 89.5), (1.0, 89.6)], "M204"),
        ([(8.0, 47.0), (8.0, 47.1), (8.0, 47.05)], "M202"),
        ([(8.0, 47.0), (8.1, 47.0), (8.1, 47.0), (8.1, 47.1)], "M209"),
    ],
)
def test_invalid_area_is_refused(corners, code):
    assert codes(geojson(ring(*corners))) == [code]
    text = " ".join(f"{east},{north}" for east, north in (*corners, corners[0]))
    assert codes(kml(polygon(text))) == [code]


def test_holes_heights_and_tiny_areas_have_findings():
    hole = INNER.format("8.502,47.302 8.503,47.302 8.503,47.303 8.502,47.302")
    assert codes(kml(polygon(SQUARE, hole))) == ["M205"]
    rings = [*ring((8, 47), (9, 47), (9, 48))["coordinates"], [[8.5, 47.1], [8.6, 47.1], [8.6, 47.2]]]
    assert codes(geojson({"type": "Polygon", "coordinates": rings})) == ["M205"]
    assert codes(kml(polygon(SQUARE.replace(",0", ",12")))) == ["M903"]
    tiny = " ".join(
        f"{8.5 + east},{47.3 + north}" for east, north in ((0, 0), (1e-7, 0), (1e-7, 1e-7), (0, 0))
    )
    assert codes(kml(polygon(tiny))) == ["M206"]
    for once in ("8,47", "8,47 8,47"):
        assert codes(kml(f"<LineString><coordinates>{once}</coordinates></LineString>")) == ["M201"]
    many = " ".join(f"{8 + each * 1e-6:.6f},47" for each in range(MAX_CORNERS + 1))
    assert codes(kml(f"<LineString><coordinates>{many}</coordinates></LineString>")) == ["M208"]
    assert codes(kml(polygon(many))) == ["M208"]
    # A line may be longer than half of a circle of latitude.
    assert codes(kml("<LineString><coordinates>-100,47 0,47 100,47</coordinates></LineString>")) == []


@given(st.integers(3, 40), st.floats(0.0, 1.0), st.integers(0, 1000))
def test_star_has_no_findings_in_both_orders_of_its_corners(count, start, seed):
    radii = [0.01 + 0.01 * ((each * seed) % 7) for each in range(count)]
    corners = [
        (8.0 + r * math.cos(a), 47.0 + r * math.sin(a))
        for each, r in enumerate(radii)
        for a in [start + math.tau * each / count]
    ]
    assert codes(geojson(ring(*corners))) == []
    assert codes(geojson(ring(*reversed(corners)))) == []


# -- invalid files ---------------------------------------------------------------------------------------

_ENTITY = "<!DOCTYPE kml [<!ENTITY x {}>]>"
_BOMB = "<!DOCTYPE kml [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {chr(98 + n)} '{('&' + chr(97 + n) + ';') * 10}'>" for n in range(9)
)


@pytest.mark.parametrize(
    ("data", "position"),
    [
        (kml("<name>&j;</name>", prologue=_BOMB + "]>"), "line 1"),
        (kml("<name>&x;</name>", prologue=_ENTITY.format("SYSTEM 'file:///etc/passwd'")), "line 1"),
        (kml(prologue="<!DOCTYPE kml SYSTEM 'http://localhost/x.dtd'>"), "line 1"),
        (kml(polygon("nan,47 8,47 8,48")), "line 1"),
        (kml(polygon("8,inf 8,47 8,48")), "line 1"),
        (kml(polygon("8,97 8,47 8,48")), "line 1"),
        (kml(polygon("181,47 8,47 8,48")), "line 1"),
        (kml(polygon("8 47 8.1 47")), "line 1"),
        (kml(polygon("8,47,1,2")), "line 1"),
        (kml(polygon("8_0,47 8,47 8,48")), "line 1"),
        (kml(polygon("٨,47 8,47 8,48")), "line 1"),
        (kml("<Folder>" * 1000 + polygon() + "</Folder>" * 1000), "line 1"),
        (kml(polygon())[:-10], "line 1"),
        (b"\n<kml>\xff</kml>", "line 2"),
        (b"<html></html>", ""),
        (b"<?xml version='1.0' encoding='klingon'?><kml/>", ""),
        (b"PK\x03\x04 a zip file", ""),
        (geojson({"type": "Polygon", "coordinates": 5}), "feature 1"),
        (geojson({"type": "Polygon", "coordinates": [[["8", "47"]]]}), "feature 1"),
        (geojson({"type": "Polygon", "coordinates": [[[8]]]}), "feature 1"),
        (geojson({"type": "Circle", "coordinates": [8, 47]}), "feature 1"),
        (geojson({"type": "Point", "coordinates": [8, 147]}), "feature 1"),
        (geojson([1]), "feature 1"),
        (b'{"type": "FeatureCollection", "features": [5]}', "feature 1"),
        (b'{"type": "FeatureCollection"}', ""),
        (b'{"type": "Polygon", "coordinates": [[[NaN, 47]]]}', ""),
        (b'{"type": "Polygon", "coordinates": ' + b"[" * 100_000, ""),
        (b'{"type": "Topology"}', ""),
        (b'{"type": "Point", "coordinates": [8, 47], "crs": {"properties": {"name": "EPSG:2056"}}}', ""),
        (b'{"type": "Point", "coordinates": [8, 47], "crs": {"properties": {"name": "EPSG:43261"}}}', ""),
        (b'{"type": "Point"}'.decode().encode("utf-16"), ""),
        (b'{"type": "Point \xff"}', ""),
        (b"", ""),
        (b"[]", ""),
    ],
)
def test_malicious_and_foreign_files_are_refused(data, position):
    with pytest.raises(MissionFileError) as error:
        read(data, "f.geojson")
    assert error.value.where == position
    assert error.value.file == "f.geojson"


def test_crs_of_wgs_84_is_read():
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}
    point = {"type": "Point", "coordinates": [8, 47], "crs": crs}
    assert len(read(json.dumps(point).encode())) == 1


def test_deeply_nested_geometry_collections_are_bounded():
    geometry = {"type": "Point", "coordinates": [8, 47]}
    for _ in range(50):
        geometry = {"type": "GeometryCollection", "geometries": [geometry]}
    with pytest.raises(MissionFileError):
        read(geojson(geometry))
