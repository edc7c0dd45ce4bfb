"""Flies the survey in virtual time: with 1, 2 and 4 copters, and with 4 copters and the loss of a computer.

`python examples/08-survey/survey_times.py` prints the table of README.md and draws tracks.svg.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from lfield.geodata.area_file import read_area_file
from lfield.geodata.polygons import LocalPlane, Point, distance_to_way, is_inside
from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.track_picture import draw
from lfield.testing.script import run_script

HERE = Path(__file__).parent
#: The origin of the team's frame, as in the devices file.
ORIGIN = LocalPlane(47.397742, 8.545594)
#: Metres: distance of two strips; height of the pictures; tolerance of a vehicle's position.
SPACING, HEIGHT, TOLERANCE = 15.0, 25.0, 1.5
#: The computer that is lost, and the time of its loss in seconds.
LOST, LOST_AT = "copter1", 100.0
#: Seconds: maximum duration of a survey.
MAX_DURATION = 1500.0


def deployment(folder: Path, count: int, field: Sequence[Point] = ()) -> Path:
    """A copy of the mission for `count` vehicles; `field` replaces the corners, metres east and north."""
    for file in (*HERE.glob("mission.*"), HERE / "field.kml"):
        shutil.copy(file, folder)
    path = folder / "mission.dL"
    path.write_text(path.read_text().replace("@base?4", f"@base?{count}"))
    if field:
        kml = (folder / "field.kml").read_text()
        start, end = kml.partition("<coordinates>")[0], kml.partition("</coordinates>")[2]
        corners = [ORIGIN.position(point) for point in [*field, field[0]]]
        text = " ".join(f"{longitude:.7f},{latitude:.7f}" for latitude, longitude in corners)
        (folder / "field.kml").write_text(f"{start}<coordinates>{text}</coordinates>{end}")
    return path


def photographed_paths(team: MissionTeam) -> Iterator[tuple[Point, Point]]:
    """The parts of completed strips at the height of the pictures: start and end, east and north."""
    for call in team.calls:
        if call.portal != "survey" or call.ended is None or call.thrown:
            continue
        points = [p for p in team.tracks[f"{call.resource}.fc"] if call.at <= p.at <= call.ended]
        for start, end in zip(points[::5], points[5::5], strict=False):
            if abs(start.up - HEIGHT) < TOLERANCE and abs(end.up - HEIGHT) < TOLERANCE:
                yield (start.east, start.north), (end.east, end.north)


def uncovered(team: MissionTeam, file: Path) -> list[Point]:
    """The points without a picture, of a grid of 3 m in the area of a file."""
    (shape,) = read_area_file(file.name, file.read_bytes())
    corners = ORIGIN.points(shape.corners)
    paths = list(photographed_paths(team))
    columns = range(int(min(x for x, _ in corners)), int(max(x for x, _ in corners)) + 1, 3)
    rows = range(int(min(y for _, y in corners)), int(max(y for _, y in corners)) + 1, 3)
    inside = [(float(x), float(y)) for x in columns for y in rows if is_inside(corners, (x, y))]
    reach = SPACING / 2.0 + TOLERANCE
    return [point for point in inside if not any(distance_to_way(point, *path) <= reach for path in paths)]


def table_row(folder: Path, count: int, *, with_loss: bool) -> str:
    """Flies the survey with `count` copters; returns its row of the table."""
    path = deployment(folder, count)
    team = MissionTeam(path)
    try:
        if with_loss:
            team.at(LOST_AT, lambda: team.crash(LOST))
        team.run(until_done=True, at_most=MAX_DURATION)
        surveys = [call for call in team.calls if call.portal == "survey"]
        seconds = max(call.ended or 0.0 for call in surveys) - min(call.at for call in surveys)
        gaps = len(uncovered(team, path.with_name("field.kml")))
        if with_loss:
            title = "survey: four copters, and the computer of m1 is lost"
            (HERE / "tracks.svg").write_text(draw(team.tracks, title, team.marks))
        vehicles = f"{count}, one computer is lost" if with_loss else str(count)
        return f"| {vehicles} | {seconds:.0f} s | {len(surveys)} | {gaps} |"
    finally:
        team.close()


def main() -> None:
    """Prints the table."""
    print("| vehicles | time | strips flown | points without a picture |\n|---|---:|---:|---:|")
    for count, with_loss in ((4, True), (4, False), (2, False), (1, False)):
        with tempfile.TemporaryDirectory() as folder:
            print(table_row(Path(folder), count, with_loss=with_loss), flush=True)


if __name__ == "__main__":
    run_script(main)
