"""Draws the mission: tracks from above, and the beam between its carriers.

`python examples/05-two-carry-one/flown.py` runs it twice, the second time with a motor of bob that fails
while he carries, and draws tracks.svg and failed.svg.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from lfield.testing.mission.call_record import RecordedCall
from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.recorders import Point

HERE = Path(__file__).parent
#: Pixels per metre; lower left and upper right corner of the picture in metres.
METRE, SOUTH, WEST, NORTH, EAST = 20.0, -12.0, -6.0, 17.5, 18.0
#: Colours that are distinguishable with colour blindness (Okabe and Ito, 2008), and that of the beam.
COLOURS = {"ada": "#0072b2", "bob": "#d55e00", "cat": "#009e73", "dan": "#cc79a7"}
BEAM = "#444"
#: Seconds since the start at which a motor of bob fails.
DEAD = 30.0
#: Metres above the ground: height of the hooks at the load, and a height below all flights.
ROPE, LOW = 2.0, 4.0


def main() -> None:
    """Runs it, and draws it."""
    for name, fails in (("tracks.svg", False), ("failed.svg", True)):
        team = shown(MissionTeam(HERE / "mission.dL"), fails=fails)
        (HERE / name).write_text(draw(team))
        team.close()


def shown(team: MissionTeam, *, fails: bool) -> MissionTeam:
    """A run of the page."""
    if fails:
        team.at(DEAD, lambda: team.fake("bob.fc").set("motor_failure=true"))
    team.run(until_done=True)
    return team


def carried(team: MissionTeam) -> Iterator[tuple[Point, Point]]:
    """The true positions of the two carriers each time that both had reached their targets."""
    hangs, carriers = False, set[str]()
    for pair in pairs(team):
        if carriers != {call.resource for call in pair} or any(call.thrown for call in pair):
            hangs, carriers = False, {call.resource for call in pair}
        if any(call.thrown for call in pair):
            continue
        if hangs or down(pair):
            moment = max(call.ended or 0.0 for call in pair)
            west, east = sorted((at(team.tracks[f"{c.resource}.fc"], moment) for c in pair), key=_east)
            yield west, east
            hangs = hangs != down(pair)


def pairs(team: MissionTeam) -> list[list[RecordedCall]]:
    """The two calls of each step of the carriers, without the flights home."""
    calls = [call for call in team.calls if call.caller == "beam" and call.portal == "flyTo"]
    found = [[one, other] for one, other in pairwise(calls) if other.at - one.at < 0.5]
    return [pair for pair in found if pair[0].arguments[0] == pair[1].arguments[0]]


def down(pair: list[RecordedCall]) -> bool:
    """Whether both are low enough to close or open the hooks."""
    return all(call.arguments[2] == -ROPE for call in pair)


def draw(team: MissionTeam) -> str:
    """An SVG of the tracks, and of the beam at the end of each step."""
    tracks = {name.partition(".")[0]: points for name, points in team.tracks.items()}
    parts = [path(points, COLOURS[name]) for name, points in tracks.items()]
    parts += [beam(west, east) for west, east in carried(team)]
    parts += [text(points[0], name, COLOURS[name]) for name, points in tracks.items()]
    for mark in team.marks:
        place = at(tracks[mark.device.partition(".")[0]], mark.at)
        parts.append(f'<path d="M{x(place) - 6:.1f} {y(place) - 6:.1f}l12 12m0 -12l-12 12" stroke="#d00"/>')
        parts.append(text(place, mark.text, "#d00"))
    width, height = (EAST - WEST) * METRE, (NORTH - SOUTH) * METRE
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" '
        f'width="{width:.0f}" font-family="sans-serif" font-size="12" stroke-width="2">\n'
        '<rect width="100%" height="100%" fill="#fff"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


def at(points: list[Point], moment: float) -> Point:
    """The position at a time."""
    return min(points, key=lambda point: abs(point.at - moment))


def x(point: Point) -> float:
    """Pixels from the left."""
    return (point.east - WEST) * METRE


def y(point: Point) -> float:
    """Pixels from the top: north is up."""
    return (NORTH - point.north) * METRE


def path(points: list[Point], colour: str) -> str:
    """A track, a point each half second."""
    places = "L".join(f"{x(point):.1f} {y(point):.1f}" for point in points[::5])
    return f'<path d="M{places}" stroke="{colour}" stroke-opacity="0.6" fill="none"/>'


def beam(west: Point, east: Point) -> str:
    """The beam between its carriers, thick where it is on the ground."""
    wide = 6 if west.up < LOW else 2
    ends = f"M{x(west):.1f} {y(west):.1f}L{x(east):.1f} {y(east):.1f}"
    return f'<path d="{ends}" stroke="{BEAM}" stroke-width="{wide}"/>'


def text(point: Point, label: str, colour: str) -> str:
    """Text beside a point."""
    return f'<text x="{x(point) + 9:.1f}" y="{y(point) + 16:.1f}" fill="{colour}">{label}</text>'


def _east(point: Point) -> float:
    return point.east


if __name__ == "__main__":
    main()
