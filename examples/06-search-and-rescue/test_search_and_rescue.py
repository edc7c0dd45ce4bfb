"""Search and rescue, on virtual time: `lfield test examples/06-search-and-rescue`."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from lfield.testing.mission.track_picture import draw

FOLDER = Path(__file__).parent
PERSONS = {(32, -13), (55, 4), (24, 17), (60, -2)}


def kits(team):
    """The places to which a kit was brought, according to the log."""
    lines = "\n".join(line.text for line in team.log)
    found = re.findall(r"(?:kit at|brought a kit to) (-?\d+), (-?\d+)", lines)
    return sorted((int(north), int(east)) for north, east in found)


def count_of_lines(name):
    """The number of lines of a program, without comments and empty lines."""
    lines = (line.strip() for line in (FOLDER / name).read_text(encoding="utf-8").splitlines())
    return sum(1 for line in lines if line and not line.startswith("//"))


def table_row(title):
    """The two numbers in a table_row of the README's table."""
    readme = (FOLDER / "README.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {title}[^|]*\| (\d+) \| (\d+) \|$", readme, re.MULTILINE)
    return tuple(map(int, row.groups()))


def line_ends(svg):
    """Start and end of each line of a drawing, in units of 20 pixels."""
    lines = [re.findall(r"[0-9.]+", line) for line in re.findall(r'd="(M[^"]*)"', svg)]
    return [[round(float(number) / 20.0) for number in (*line[:2], *line[-2:])] for line in lines]


def has_visited(team, device, place):
    """Whether a vehicle has been within 1.5 m of a place."""
    return any(math.dist((point.north, point.east), place) < 1.5 for point in team.tracks[device])


@pytest.mark.few(0)
def test_rovers_bring_one_kit_to_each_person_during_the_search(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until_done=True)
    assert team.ended == {"rescue": "done"}
    assert kits(team) == sorted(PERSONS)
    assert all(has_visited(team, "r1.fc", place) or has_visited(team, "r2.fc", place) for place in PERSONS)
    assert team.said("rescue: 4 persons found, 0 without a kit, 0 strips not searched") == 1
    searches = [call for call in team.calls if call.portal == "search"]
    deliveries = [call for call in team.calls if call.portal == "deliver"]
    assert min(call.at for call in deliveries) < max(call.ended for call in searches), (
        "rovers must not wait for the search"
    )
    assert len(searches) == 6
    assert table_row("portal calls")[1] == len(team.calls)
    assert table_row("hops")[1] == len(team.hops)
    drawing = (FOLDER / "tracks.svg").read_text(encoding="utf-8")
    new_drawing = draw(team.tracks, "search and rescue", team.marks)
    assert line_ends(new_drawing) == line_ends(drawing), "tracks.svg is outdated"


@pytest.mark.few(0)
def test_polling_program_delivers_the_same_kits_with_more_calls(lfield_mission):
    team = lfield_mission("polling.dL")
    team.run(until_done=True)
    assert set(team.ended.values()) == {"done"}
    assert kits(team) == sorted(PERSONS)
    assert table_row("portal calls")[0] == len(team.calls)
    assert table_row("hops")[0] == len(team.hops)
    assert table_row("lines of L") == (count_of_lines("polling.L"), count_of_lines("mission.L"))


@pytest.mark.few(0)
def test_another_copter_searches_the_strip_of_a_failed_one(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until="is searched")
    team.fake("c2.fc").set("silence=true")
    team.run(until_done=True, at_most=600.0)
    assert team.ended == {"rescue": "done"}
    assert kits(team) == sorted(PERSONS)
    assert team.said("c2.fc is out: ") == 1
    strips = [line.text for line in team.log if "is searched" in line.text]
    assert len(set(strips)) == len(strips) == 6


@pytest.mark.few(0)
def test_other_rover_brings_the_kit_when_a_rovers_computer_fails(lfield_mission):
    team = lfield_mission("mission.dL")
    team.run(until=lambda: any(call.portal == "deliver" for call in team.calls))
    first = next(call for call in team.calls if call.portal == "deliver")
    team.run(2.0)
    team.crash({"r1": "rover1", "r2": "rover2"}[first.resource])
    team.run(until_done=True, at_most=600.0)
    assert team.ended == {"rescue": "done"}
    assert kits(team) == sorted(PERSONS)
