"""Draws the tracks of the copters from above, and the beam between its carriers.

`python examples/05-two-carry-one/draw_tracks.py` runs the mission without failures and draws tracks.svg, then
runs the mission with a motor failure of the carrier bob and draws failed.svg.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from lfield.testing.mission.call_record import RecordedCall
from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.recorders import Point

HERE = Path(__file__).parent
#: Pixels per metre; lower left and upper right corner of the drawing in metres.
METRE, SOUTH, WEST, NORTH, EAST = 20.0, -12.0, -6.0, 17.5, 18.0
#: Colours that are distinguishable with colour blindness (Okabe and Ito, 2008), and that of the beam.
COLOURS = {"ada": "#0072b2", "bob": "#d55e00", "cat": "#009e73", "dan": "#cc79a7"}
BEAM = "#444"
#: Seconds from the start of the mission until the motor failure of bob.
FAILURE_TIME = 30.0
#: Metres above the ground: height of a copter whose hook is at the load; a height below all other flights.
HOOK_HEIGHT, LOW = 2.0, 4.0


def main() -> None:
    """Runs the mission without and with a failure, and draws each run."""
    for name, bob_fails in (("tracks.svg", False), ("failed.svg", True)):
        team = MissionTeam(HERE / "mission.dL")
        run_mission(team, bob_fails=bob_fails)
        (HERE / name).write_text(draw(team))
        team.close()


def run_mission(team: MissionTeam, *, bob_fails: bool) -> None:
    """Runs the mission to its end."""
    if bob_fails:
        team.at(FAILURE_TIME, lambda: team.fake("bob.fc").set("motor_failure=true"))
    team.run(until_done=True)


def carrier_positions(team: MissionTeam) -> Iterator[tuple[Point, Point]]:
    """The true positions of the western and the eastern carrier at the end of each step with the beam."""
    has_beam, carriers = False, set[str]()
    for step in carrier_steps(team):
        failed = any(call.thrown for call in step)
        if failed or carriers != {call.resource for call in step}:
            has_beam, carriers = False, {call.resource for call in step}
        if not failed and (has_beam or is_at_load(step)):
            time = max(call.ended or 0.0 for call in step)
            first, second = (position_at(team.tracks[f"{call.resource}.fc"], time) for call in step)
            yield (first, second) if first.east < second.east else (second, first)
            # At the load, the hooks close if they were open, and open if they were closed.
            has_beam = has_beam != is_at_load(step)


def carrier_steps(team: MissionTeam) -> list[list[RecordedCall]]:
    """The two simultaneous calls of each step of the carriers, without the flights home."""
    calls = [call for call in team.calls if call.caller == "beam" and call.portal == "flyTo"]
    steps = [[first, second] for first, second in pairwise(calls) if second.at - first.at < 0.5]
    return [step for step in steps if step[0].arguments[0] == step[1].arguments[0]]


def is_at_load(step: list[RecordedCall]) -> bool:
    """Whether both copters fly low enough to close or open the hooks."""
    return all(call.arguments[2] == -HOOK_HEIGHT for call in step)


def draw(team: MissionTeam) -> str:
    """An SVG of the tracks, and of the beam at the end of each step."""
    tracks = {name.partition(".")[0]: points for name, points in team.tracks.items()}
    parts = [track_line(points, COLOURS[name]) for name, points in tracks.items()]
    parts += [beam_line(west, east) for west, east in carrier_positions(team)]
    parts += [text(points[0], name, COLOURS[name]) for name, points in tracks.items()]
    for mark in team.marks:
        place = position_at(tracks[mark.device.partition(".")[0]], mark.at)
        parts.append(f'<path d="M{x(place) - 6:.1f} {y(place) - 6:.1f}l12 12m0 -12l-12 12" stroke="#d00"/>')
        parts.append(text(place, mark.text, "#d00"))
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
    return f'<path d="M{places}" stroke="{colour}" stroke-opacity="0.6" fill="none"/>'


def beam_line(west: Point, east: Point) -> str:
    """The beam between its carriers, thicker on the ground."""
    width = 6 if west.up < LOW else 2
    ends = f"M{x(west):.1f} {y(west):.1f}L{x(east):.1f} {y(east):.1f}"
    return f'<path d="{ends}" stroke="{BEAM}" stroke-width="{width}"/>'


def text(point: Point, label: str, colour: str) -> str:
    """A text beside a point."""
    return f'<text x="{x(point) + 9:.1f}" y="{y(point) + 16:.1f}" fill="{colour}">{label}</text>'


if __name__ == "__main__":
    main()
