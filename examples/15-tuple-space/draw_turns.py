"""Draws the turns of the clients: time from left to right, hosts from top to bottom.

`python examples/15-tuple-space/draw_turns.py` runs the mission with a host failure, and draws tracks.svg.
"""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from lfield.testing.mission.call_record import RecordedCall
from lfield.testing.mission.mission_team import MissionTeam

HERE = Path(__file__).parent
#: Pixels: per second, per host, left margin, distance of the lanes of the space.
SECOND, ROW, LEFT, LANE = 84.0, 72.0, 64.0, 8.0
#: Hosts from top to bottom, with the space's host in the middle; colours of clients (Okabe and Ito, 2008).
HOSTS = ("sky", "north", "farm", "south", "east")
COLOURS = {"scout": "#0072b2", "hoe1": "#d55e00", "hoe2": "#009e73", "fork": "#cc79a7"}


def main() -> None:
    """Runs the mission and draws it."""
    team = MissionTeam(HERE / "mission.dL")
    run_with_host_failure(team)
    (HERE / "tracks.svg").write_text(draw(team))
    team.close()


def run_with_host_failure(team: MissionTeam) -> None:
    """Runs the mission; the computer of a hoe fails while the hoe pulls a weed, and restarts."""
    team.at(4.0, lambda: team.crash("north"))
    team.at(5.5, lambda: team.boot("north"))
    team.run(until_done=True)


def draw(team: MissionTeam) -> str:
    """An SVG of hops, processed tuples, and failures of hosts."""
    parts = [text(8, y(host) + 4, host, "#222") for host in HOSTS]
    parts += [text(8, y(host_of(team, client)) + 18, client, colour) for client, colour in COLOURS.items()]
    parts += [f'<path d="M{LEFT} {y(h)}H{x(team.now):.1f}" stroke="#ddd"/>' for h in HOSTS]
    parts += [text(x(t), y("east") + 40, f"{t} s", "#888") for t in range(int(team.now) + 1)]
    parts += [carrier_path(team, client) for client in COLOURS]
    parts += [tuple_box(team, call) for call in team.calls if has_processed_tuple(call)]
    for mark in team.marks:
        place = y(mark.text.split()[0])
        parts.append(f'<path d="M{x(mark.at) - 5:.1f} {place - 5}l10 10m0 -10l-10 10" stroke="#d00"/>')
        parts.append(text(x(mark.at) - 4, place - 20, mark.text, "#d00"))
    width, height = x(team.now) + 40, y("east") + 56
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        'font-family="sans-serif" font-size="11">\n<rect width="100%" height="100%" fill="#fff"/>\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


def carrier_path(team: MissionTeam, client: str) -> str:
    """The hosts of a client's coordinator over time; at the space, each coordinator has its own lane."""
    lane = LANE * (list(COLOURS).index(client) - 1.5)
    path = ""
    for hop in (hop for hop in team.hops if hop.agent == f"{client}-carrier"):
        ends = [y(host) + lane * (host == "farm") for host in (hop.source, hop.target)]
        path += f"{'L' if path else 'M'}{x(hop.at):.1f} {ends[0]}V{ends[1]}"
    return f'<path d="{path}" stroke="{COLOURS[client]}" fill="none" stroke-width="1.5"/>'


def has_processed_tuple(call: RecordedCall) -> bool:
    """Whether a client processed a tuple in this call, completely or until the failure of its host."""
    return call.portal == "reply" and (call.ended is None or call.ended > call.at)


def tuple_box(team: MissionTeam, call: RecordedCall) -> str:
    """A box for the tuple that a client processes; dashed if its host fails."""
    place = y(host_of(team, call.resource))
    end = call.ended or next(mark.at for mark in team.marks if mark.at > call.at)
    dashed = "" if call.ended else ' stroke-dasharray="4"'
    return (
        f'<rect x="{x(call.at):.1f}" y="{place - 11}" width="{x(end) - x(call.at):.1f}" height="22" rx="4" '
        f'fill="#fff" stroke="{COLOURS[call.resource]}"{dashed}/>\n'
        + text(x(call.at) + 4, place + 4, " ".join(fields(call.arguments[0])), COLOURS[call.resource])
    )


def fields(tuple_: Any) -> Iterator[str]:
    """The fields of a tuple, without the leading name except for rows."""
    values = tuple_.values
    yield from values if values[0] == "row" else values[1:]


def host_of(team: MissionTeam, agent: str) -> str:
    """The host of an agent in the deployment."""
    deployed = team.mission.team
    return next(deployed.hosts[member.host] for member in deployed.members if member.id == agent)


def x(seconds: float) -> float:
    """Pixels from the left."""
    return LEFT + SECOND * seconds


def y(host: str) -> float:
    """Pixels from the top."""
    return ROW * HOSTS.index(host) + 44.0


def text(x: float, y: float, label: str, colour: str) -> str:
    """A text at a point."""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}">{escape(label)}</text>'


if __name__ == "__main__":
    main()
