"""`lfield plan`: status, summary, JSON and pictures of mission and area files."""

from __future__ import annotations

import json
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from lfield import exit_status
from lfield.cli.main import main

FILES = Path(__file__).parents[2] / "mavlink" / "files"
PLAN, KML = str(FILES / "north-field.plan"), str(FILES / "north.kml")
HOME = ("--home", "47.3977419,8.545594")


@pytest.fixture
def plan(capsys):
    """Run `lfield plan`; returns its status, output and errors."""

    def run(*arguments):
        status = main(["plan", *map(str, arguments)])
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


def test_a_valid_plan_is_one_line(plan):
    status, out, _ = plan("check", PLAN, "--kind", "copter", "--radius", "100", "--altitude", "30")
    assert status == exit_status.DONE
    assert len(out.splitlines()) == 1
    assert "12 items" in out


def test_every_fault_of_a_plan_is_a_line(plan):
    status, out, _ = plan(
        "check", PLAN, "--kind", "rover", "--firmware", "px4", "--radius", "80", "--speed", "3"
    )
    assert status == exit_status.DATA
    assert [line.partition("[")[2][:4] for line in out.splitlines()[:-1]] == ["M101", "M102", *["M104"] * 4]


def test_plan_check_prints_json(plan):
    status, out, _ = plan("check", PLAN, "--json", "--altitude", "15")
    report = json.loads(out)
    assert status == exit_status.DATA
    assert (report["items"], report["kind"], report["firmware"]) == (12, "copter", "ardupilot")
    assert (report["fence"], report["rally"], report["highest"]) == (2, 1, {"metres": 20.0, "item": 1})
    assert [finding["item"] for finding in report["findings"]] == list(range(1, 12))
    assert {(finding["severity"], finding["code"]) for finding in report["findings"]} == {("error", "M104")}
    assert all(finding["message"] for finding in report["findings"])


def test_plan_check_reads_an_area(plan):
    assert plan("check", KML)[0] == exit_status.DONE
    assert plan("check", KML, "--name", "north field")[0] == exit_status.DONE
    assert plan("check", KML, "--radius", "100", *HOME)[0] == exit_status.DONE
    status, out, _ = plan("check", KML, "--radius", "50", *HOME, "--json")
    assert status == exit_status.DATA
    report = json.loads(out)
    assert [finding["code"] for finding in report["findings"]] == ["M207", "M207"]
    assert report["extent"] == pytest.approx(4900.0, rel=0.01)
    assert report["length"] == pytest.approx(280.0, rel=0.01)


def test_a_self_intersecting_area_is_refused_and_a_line_accepted(plan, tmp_path):
    line = tmp_path / "line.json"
    line.write_text('{"type": "LineString", "coordinates": [[8, 47], [8.001, 47]]}')
    assert plan("check", line)[0] == exit_status.DONE
    bow = tmp_path / "bow.geojson"
    bow.write_text(
        '{"type": "Polygon", "coordinates": [[[8, 47], [8.1, 47.1], [8.1, 47], [8, 47.1], [8, 47]]]}'
    )
    status, out, _ = plan("check", bow)
    assert status == exit_status.DATA
    assert "M202" in out


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", KML, "--radius", "50"),
        ("check", PLAN, "--name", "north field"),
        ("check", PLAN, "--radius", "-1"),
        ("check", PLAN, "--radius", "nan"),
        ("check", PLAN, "--altitude", "high"),
        ("check", PLAN, "--home", "47"),
        ("check", PLAN, "--home", "97,8"),
        ("check", PLAN, "--kind", "balloon"),
        ("show", PLAN),
        ("draw", PLAN),
        (),
    ],
)
def test_usage_errors_of_plan(plan, arguments):
    assert plan(*arguments)[0] == exit_status.USAGE


def test_unreadable_plan_files_are_refused(plan, tmp_path):
    bad = tmp_path / "bad.plan"
    bad.write_text(
        '{"fileType": "Plan", "version": 1, "mission": {"version": 2, "items": [{"type": "SimpleItem"}]}}'
    )
    status, out, err = plan("check", bad, "--json")
    assert status == exit_status.DATA
    assert json.loads(out)["code"] == "mission-file"
    assert "item 1" in err
    assert plan("check", tmp_path / "none.plan")[0] == exit_status.NO_INPUT
    assert plan("check", KML, "--name", "south")[0] == exit_status.DATA
    large = tmp_path / "large.plan"
    with large.open("wb") as stream:
        stream.truncate(100 << 20)
    assert plan("check", large)[0] == exit_status.NO_INPUT


@pytest.mark.parametrize(("file", "texts"), [(PLAN, ["1 takeoff", "R1", "H"]), (KML, ["area"])])
def test_plan_show_draws_pictures(plan, tmp_path, file, texts):
    out = tmp_path / "f.svg"
    assert plan("show", file, "--out", out)[0] == exit_status.DONE
    labels = [element.text for element in ET.parse(out).iter() if element.text and element.text.strip()]
    assert set(texts) <= set(labels)
    assert any(text.startswith("a square is") for text in labels)


def test_a_plan_without_a_position_has_no_picture(plan, tmp_path):
    empty = tmp_path / "empty.plan"
    empty.write_text('{"fileType": "Plan", "version": 1, "mission": {"version": 2}}')
    assert plan("show", empty, "--out", tmp_path / "f.svg")[0] == exit_status.DATA
    assert plan("show", PLAN, "--out", tmp_path / "no" / "f.svg")[0] == exit_status.NO_OUTPUT


def test_a_missing_driver_library_is_reported(plan, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink", None)
    status, _, err = plan("check", PLAN)
    assert status == exit_status.UNAVAILABLE
    assert "lfield[mavlink]" in err
    # Maps are read without it.
    assert plan("check", KML)[0] == exit_status.DONE
