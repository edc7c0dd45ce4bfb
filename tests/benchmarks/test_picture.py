"""The picture of the figures: its content, and its copy in the documentation matches the saved rows."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from harness.picture import Pictured, caption, draw, fields_of
from run import PICTURED

ROWS = Path(__file__).with_name("rows.json")
PICTURE = Path(__file__).parents[2] / "lfield" / "docs" / "figures.svg"
SVG = "{http://www.w3.org/2000/svg}"


def row(case, measured, size, *, figure="cats", unit="s", error="", numbers=(1e-3, 2e-3, 4e-3)):
    low, middle, high = numbers
    reported = {
        "figure": figure,
        "case": case,
        "measured": measured,
        "size": size,
        "unit": unit,
        "error": error,
    }
    return reported | {"min": low, "median": middle, "max": high}


ROWS_OF_CATS = [
    row("1 cat", "a", 1),
    row("10 cats", "a", 10, numbers=(1e-2, 2e-2, 4e-2)),
    row("10 cats: asleep", "a", 10),
    row("1 cat", "b <&>", 1),
    row("10 cats", "b <&>", 10),
    row("1 cat", "gone", 1, error="OSError"),
    row("1 cat", "once", 1),
    row("ten times the size", "a", 0, unit="x", numbers=(9.5, 10.0, 10.5)),
    row("ten times the size: asleep", "a", 0, unit="x"),
    row("1 dog", "a", 1, figure="dogs"),
    row("", "a", 0, figure="birds"),
]


def test_field_has_every_contender_measured_at_two_sizes():
    (field,) = fields_of(ROWS_OF_CATS, {name: Pictured(name, "many") for name in ("cats", "dogs", "birds")})
    assert (field.title, field.over, field.unit) == ("cats", "many", "s")
    assert {name: [tuple(point) for point in line] for name, line in field.lines.items()} == {
        "a": [(1, 1e-3, 2e-3, 4e-3), (10, 1e-2, 2e-2, 4e-2)],
        "b <&>": [(1, 1e-3, 2e-3, 4e-3), (10, 1e-3, 2e-3, 4e-3)],
    }
    assert field.growths == {"a": 10.0}


def test_only_selected_contenders_are_drawn():
    (field,) = fields_of(ROWS_OF_CATS, {"cats": Pictured("cats", "many", "b")})
    assert list(field.lines) == ["b <&>"]


def test_one_cost_of_a_figure_with_several():
    rows = [*ROWS_OF_CATS, row("1 cat: asleep", "a", 1)]
    (field,) = fields_of(rows, {"cats": Pictured("cats", "many", cost="asleep")})
    assert [point.size for point in field.lines["a"]] == [1, 10]
    assert field.growths == {"a": 2e-3}


def _numbers(path):
    return [tuple(map(float, place.split())) for place in path.get("d")[1:].split("L")]


def test_line_rises_with_its_cost_on_logarithmic_axes():
    rows = [row(f"{n} cats", "a", n, numbers=(n * 1e-6,) * 3) for n in (1, 10, 100)]
    drawn = ElementTree.fromstring(draw(fields_of(rows, {"cats": Pictured("Cats", "cats")}), "about"))
    (line,) = [path for path in drawn.iter(f"{SVG}path") if path.get("stroke-width") == "2"]
    (x0, y0), (x1, y1), (x2, y2) = _numbers(line)
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.2)
    assert y0 - y1 == pytest.approx(y1 - y2, abs=0.2)
    assert y0 > y2
    texts = [text.text for text in drawn.iter(f"{SVG}text")]
    assert texts == ["about", "Cats", "1", "10", "100", "1 µs", "10 µs", "100 µs", "cats", "a"]


def test_constant_cost_is_drawn():
    rows = [row(f"{n} cats", "a", n, numbers=(2e-3,) * 3) for n in (1, 10)]
    drawn = draw(fields_of(rows, {"cats": Pictured("Cats", "cats")}), "about")
    assert "nan" not in drawn
    assert "2 ms" in drawn


def test_names_are_escaped_and_growths_follow_them():
    drawn = draw(fields_of(ROWS_OF_CATS, {"cats": Pictured("Cats", "cats")}), "about")
    assert "b &lt;&amp;&gt;" in drawn
    assert ">a, ten times: 10x<" in drawn


def test_empty_picture_is_an_error():
    with pytest.raises(ValueError, match="none of these figures has sizes"):
        draw(fields_of(ROWS_OF_CATS, {"birds": Pictured("Birds", "birds")}), "about")


def test_picture_in_the_documents_equals_the_saved_rows():
    saved = json.loads(ROWS.read_text(encoding="utf-8"))
    fields = fields_of(saved["rows"], PICTURED)
    assert [field.title for field in fields] == [chosen.title for chosen in PICTURED.values()]
    assert PICTURE.read_text(encoding="utf-8") == draw(fields, caption(saved))
