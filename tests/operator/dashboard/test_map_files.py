"""The content of the map: tracks as points at a distance, and the drawings of files and programs."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from lfield.errors import LfieldError, MissionFileError
from lfield.geodata.map_drawings import MAX_DRAWN, MapDrawing, drawings_of
from lfield.geodata.mission_files import PlanReport, PlanZone
from lfield.geodata.polygons import LocalPlane
from lfield.mission import bundle
from lfield.mission.loader import load_mission
from lfield.operator.dashboard.map_files import file_drawings, program_drawings
from lfield.operator.team_model.team_state import GeoPosition, LocalPosition, VehicleState
from lfield.operator.team_model.vehicle_tracks import MAX_POINTS, MOST_KEPT, TeamTracks

FILES = Path(__file__).parents[2] / "mavlink" / "files"
PROGRAM = """
const string NORTH = "north.kml";
real[] corners() { return mapArea(NORTH); }

resource Copter {
    Mavlink fc;
    init(string[] arg) { }
    portal fly() {
        real[] field = corners();
        fc.flyPlan("north-field.plan");
        write("two lines\\nand {\\n");
    }
}
"""


def vehicle(north, east=0.0, **more):
    place = LocalPosition(north, east, -5.0)
    return VehicleState("lead", "Copter", "alpha", True, place, GeoPosition(47.0 + north * 1e-5, 8.5), **more)


def test_track_points_are_sent_once_and_completely_to_a_new_browser():
    tracks = TeamTracks()
    for north in (0.0, 0.05, 1.0, 2.0):
        tracks.add([vehicle(north)])
    all_tracks = tracks.since(0)
    assert (all_tracks.is_whole, all_tracks.newest) == (True, 3)
    assert [point.position for point in all_tracks.tracks[0].points] == [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)]
    assert tracks.since(3).tracks == []
    tracks.add(
        [vehicle(3.0), replace(vehicle(9.0), fresh=False), replace(vehicle(9.0), is_position_stated=True)]
    )
    update = tracks.since(3)
    assert (update.is_whole, [point.position for point in update.tracks[0].points]) == (False, [(3.0, 0.0)])
    assert tracks.since(99).is_whole, "a number of another server"


def test_a_long_track_is_thinned():
    tracks = TeamTracks()
    for north in range(3 * MOST_KEPT):
        tracks.add([vehicle(float(north))])
    points = tracks.since(0).tracks[0].points
    assert MAX_POINTS / 4 < len(points) <= MAX_POINTS
    assert points[-1].position[0] > 3 * MOST_KEPT - 10


def test_drawings_of_a_program_are_the_same_from_a_bundle(tmp_path):
    for name in ("north.kml", "north-field.plan"):
        (tmp_path / name).write_bytes((FILES / name).read_bytes())
    (tmp_path / "m.L").write_text(PROGRAM)
    (tmp_path / "m.dL").write_text("//Copter:lead@alpha\n")
    mission = load_mission(tmp_path / "m.dL", simulate=True)
    drawn = program_drawings(mission.program)
    kinds = [(each.kind, each.name) for each in drawn]
    plan = "north-field.plan"
    assert kinds == [
        ("area", "north.kml"),
        *((kind, plan) for kind in ("inside", "outside", "way", "rally", "home")),
    ]
    (tmp_path / "m.lfm").write_bytes(bundle.encode(mission))
    assert program_drawings(bundle.read(tmp_path / "m.lfm").program) == drawn
    files = file_drawings([FILES / "north.kml", FILES / plan])
    # A program has only the parts of a plan that a vehicle needs: not the area of its survey.
    assert [each for each in files if each.kind != "area" or each.name != plan] == drawn
    assert drawn[3].numbers[:2] == (1, 2)


def test_a_circle_is_drawn_with_its_radius():
    zone = PlanZone(False, ((60.0, 10.0),), 50.0)
    (drawing,) = drawings_of("f.plan", PlanReport(zones=[zone]))
    assert drawing.kind == "outside"
    points = LocalPlane(60.0, 10.0).points(drawing.points)
    assert all(abs((x * x + y * y) ** 0.5 - 50.0) < 0.01 for x, y in points)


def test_a_huge_file_is_drawn_in_part():
    corners = tuple((47.0 + n * 1e-7, 8.5) for n in range(MAX_DRAWN))
    report = PlanReport(areas=[corners], home=(47.0, 8.5))
    assert drawings_of("f.kml", report) == [MapDrawing("area", "f.kml", corners)]


@pytest.mark.parametrize(
    "text", ["<kml><Document/></kml>", "{", "<kml", '{"type": "Point", "coordinates": [8, 47]}']
)
def test_a_file_with_nothing_to_draw_is_refused(tmp_path, text):
    (tmp_path / "f.geojson").write_text(text)
    with pytest.raises(LfieldError) as error:
        file_drawings([tmp_path / "f.geojson"])
    assert isinstance(error.value, MissionFileError)
