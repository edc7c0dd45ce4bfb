"""Draws the arm from the side and from above, at the positions where it grips and releases the cubes.

`python examples/07-so101-arm/draw_arm.py` runs the mission on virtual time and draws arm.svg.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from lfield.testing.mission.mission_team import MissionTeam

HERE = Path(__file__).parent
#: Metres, as in mission.dL: height and distance of the shoulder, upper arm, forearm, hand.
HEIGHT, DISTANCE, UPPER, LOWER, HAND = 0.1166, 0.0304, 0.116, 0.135, 0.1594
#: Pixels per metre; metres: width and height of a view, distance of its origin from the left and lower edges.
METRE, WIDE, TALL, LEFT, BELOW = 900.0, 0.4, 0.32, 0.04, 0.02
#: Colours that are distinguishable with colour blindness (Okabe and Ito, 2008).
COLOURS = ("#0072b2", "#009e73", "#cc79a7", "#d55e00")

Place = Sequence[float]


def main() -> None:
    """Runs the mission and draws the arm."""
    team = MissionTeam(HERE / "mission.dL")
    team.run(until_done=True)
    (HERE / "arm.svg").write_text(draw(team))
    team.close()


def targets(team: MissionTeam) -> list[tuple[Place, Place]]:
    """For each pick and place: the commanded position, and the measured position of the tool afterwards."""
    calls = [call for call in team.calls if call.portal in ("pick", "place", "toolPlace")]
    return [
        (call.arguments[0], measurement.result)
        for call, measurement in zip(calls[::2], calls[1::2], strict=True)
        if not call.thrown
    ]


def pose(place: Place) -> list[tuple[float, float]]:
    """Base, shoulder, elbow, wrist and tool in the plane of the arm: metres outwards and up."""
    radius, height = math.hypot(place[0], place[1]), place[2] + HAND
    distance = math.hypot(radius - DISTANCE, height - HEIGHT)
    bend = math.acos((UPPER**2 + distance**2 - LOWER**2) / (2.0 * UPPER * distance))
    lift = math.atan2(height - HEIGHT, radius - DISTANCE) + bend
    elbow = DISTANCE + UPPER * math.cos(lift), HEIGHT + UPPER * math.sin(lift)
    return [(0.0, 0.0), (DISTANCE, HEIGHT), elbow, (radius, height), (radius, place[2])]


def draw(team: MissionTeam) -> str:
    """An SVG of the side view and the plan view."""
    positions = targets(team)
    wide, tall = WIDE * METRE, TALL * METRE
    parts = [text(10.0, 18.0, "from the side"), text(wide + 10.0, 18.0, "from above")]
    parts.append(f'<path d="M0 {from_side((0.0, 0.0))[1]:.1f}H{wide:.0f}" stroke="#888"/>')
    picks, box = positions[::2], positions[1]
    for number, ((target, tool), colour) in enumerate(zip([*picks, box], COLOURS, strict=True), 1):
        name = f"cube {number}" if number < len(COLOURS) else "box"
        parts += [arm_line(target, colour, 0.9), arm_line(tool, colour, 0.3)]
        x, y = from_above(tool)
        base = from_above((0.0, 0.0))
        parts.append(
            f'<path d="M{base[0]:.1f} {base[1]:.1f}L{x:.1f} {y:.1f}" stroke="{colour}" stroke-opacity="0.6"/>'
        )
        x, y = from_above(target)
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" stroke="{colour}" fill="none"/>')
        parts.append(text(x + 10.0, y - 8.0, name, colour))
    size = f'viewBox="0 0 {2 * wide:.0f} {tall:.0f}" width="{2 * wide:.0f}"'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} '
        'font-family="sans-serif" font-size="12" stroke-width="3" stroke-linecap="round">\n'
        '<rect width="100%" height="100%" fill="#fff"/>\n' + "\n".join(parts) + "\n</svg>\n"
    )


def from_side(point: tuple[float, float]) -> tuple[float, float]:
    """Pixels of a point in the side view."""
    return (point[0] + LEFT) * METRE, (TALL - BELOW - point[1]) * METRE


def from_above(place: Place) -> tuple[float, float]:
    """Pixels of a position in the plan view, where the arm points up."""
    return (1.5 * WIDE - place[1]) * METRE, (TALL - BELOW - place[0]) * METRE


def arm_line(place: Place, colour: str, opacity: float) -> str:
    """The arm in the side view."""
    points = "L".join(f"{x:.1f} {y:.1f}" for x, y in map(from_side, pose(place)))
    return f'<path d="M{points}" stroke="{colour}" stroke-opacity="{opacity}" fill="none"/>'


def text(x: float, y: float, label: str, colour: str = "#444") -> str:
    """A text at a point."""
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}">{label}</text>'


if __name__ == "__main__":
    main()
