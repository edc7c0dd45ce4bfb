"""Draws the tracks from above, and the formation at the end of each leg.

`python examples/20-formation/draw_march.py` runs the march with a motor failure of bob, and draws tracks.svg.
"""

from __future__ import annotations

from pathlib import Path

from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.recorders import Point

HERE = Path(__file__).parent
#: Pixels per metre; lower left and upper right corner of the drawing in metres from the start.
METRE, SOUTH, WEST, NORTH, EAST = 14.0, -9.0, -20.0, 23.0, 32.0
#: Colours that are distinguishable with colour blindness (Okabe and Ito, 2008).
COLOURS = {"ada": "#0072b2", "bob": "#d55e00", "cat": "#009e73", "dan": "#cc79a7", "eve": "#e69f00"}
#: Seconds from the start of the mission until the motor failure of bob.
FAILURE_TIME = 38.0


def main() -> None:
    """Runs the march and draws it."""
    team = MissionTeam(HERE / "mission.dL")
    team.at(FAILURE_TIME, lambda: team.fake("bob.fc").set("motor_failure=true"))
    team.run(until_done=True)
    (HERE / "tracks.svg").write_text(draw(team))
    team.close()


def draw(team: MissionTeam) -> str:
    """An SVG of the tracks, with a disc for each robot at the end of each leg."""
    tracks = {name.partition(".")[0]: points for name, points in team.tracks.items()}
    parts = [track_line(points, COLOURS[name]) for name, points in tracks.items()]
    parts += [text(points[0], name, COLOURS[name]) for name, points in tracks.items()]
    for line in (line for line in team.log if " is at (" in line.text):
        members = [name for name in tracks if name != "bob" or line.at < FAILURE_TIME]
        places = {name: position_at(tracks[name], line.at) for name in members}
        parts += [disc(place, COLOURS[name]) for name, place in places.items()]
        parts.append(text(max(places.values()), line.text.removeprefix("march: "), "#222"))
    failure = position_at(tracks["bob"], FAILURE_TIME)
    parts.append(f'<path d="M{x(failure) - 6:.1f} {y(failure) - 6:.1f}l12 12m0 -12l-12 12" stroke="#d00"/>')
    parts.append(text(failure, "a motor of bob is dead", "#d00"))
    width, height = (EAST - WEST) * METRE, (NORTH - SOUTH) * METRE
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" font-family="sans-serif" font-size="12" stroke-width="2">\n'
        '<rect width="100%" height="100%" fill="#fff"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


def position_at(track: list[Point], time: float) -> Point:
    """The point of a track nearest to a time in seconds."""
    return min(track, key=lambda point: abs(point.at - time))


def x(point: Point) -> float:
    """Pixels from the left."""
    return (point.east - WEST) * METRE


def y(point: Point) -> float:
    """Pixels from the top: north is up."""
    return (NORTH - point.north) * METRE


def track_line(points: list[Point], colour: str) -> str:
    """A track, with two points for each second."""
    places = "L".join(f"{x(point):.1f} {y(point):.1f}" for point in points[::5])
    return f'<path d="M{places}" stroke="{colour}" stroke-opacity="0.5" fill="none"/>'


def disc(point: Point, colour: str) -> str:
    """A disc for a robot in a formation."""
    return f'<circle cx="{x(point):.1f}" cy="{y(point):.1f}" r="6" fill="{colour}"/>'


def text(point: Point, label: str, colour: str) -> str:
    """A text beside a point."""
    return f'<text x="{x(point) + 9:.1f}" y="{y(point) - 9:.1f}" fill="{colour}">{label}</text>'


if __name__ == "__main__":
    main()
