"""Boxes on slopes and in mud: how near to its goal three rovers bring one.

`python examples/21-box-pushing/terrain_pushes.py` prints a table.
"""

from __future__ import annotations

import math
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.script import run_script

HERE = Path(__file__).parent
#: Goal of the box: north, east (m), heading (rad).
GOAL = (3.0, 1.0, 0.5)
#: Each row: what differs, and the world of the plane (`world.py`).
TERRAINS: tuple[tuple[str, str], ...] = (
    ("flat", ""),
    ("slope of 3 % to the east", "slope=0.03"),
    ("slope of 6 % to the east", "slope=0.06"),
    ("slope of 6 % to the west", "slope=-0.06"),
    ("mud, friction x 1.5", "mud=1.5"),
    ("mud, friction x 2", "mud=2"),
    ("mud, friction x 3", "mud=3"),
    ("slope of 6 % to the east, and mud, friction x 1.5", "slope=0.06 mud=1.5"),
)


@dataclass(frozen=True)
class Push:
    """The end of a push: distance from the goal (m), heading error (rad), steps, hops."""

    away: float
    turned: float
    steps: int
    hops: int


def push(world: str, seed: int = 0) -> Push:
    """One push on a terrain, with the program of the example."""
    devices = (HERE / "mission.devices.yaml").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for name in ("mission.L", "mission.dL"):
            (place / name).write_bytes((HERE / name).read_bytes())
        changed = re.sub(r"(robot: \d),", rf'\1, world: "{world}",', devices)
        (place / "mission.devices.yaml").write_text(changed, encoding="utf-8")
        team = MissionTeam(place / "mission.dL", seed=seed)
        try:
            team.run(until_done=True)
            (line,) = [line.text for line in team.log if "the box is at" in line.text]
        finally:
            team.close()
    north, east, heading = map(float, re.findall(r"-?\d+\.\d+", line))
    steps, hops = map(int, re.findall(r"after (\d+) steps and (\d+) hops", line)[0])
    return Push(math.dist((north, east), GOAL[:2]), abs(heading - GOAL[2]), steps, hops)


def row(name: str, end: Push) -> str:
    """A row of the table."""
    return f"| {name} | {end.away:.2f} m | {end.turned:.2f} rad | {end.steps} | {end.hops} |"


def main() -> None:
    """Print the table."""
    print("| terrain | from the goal | heading error | steps | hops |\n|---|---:|---:|---:|---:|")
    for name, world in TERRAINS:
        print(row(name, push(world)), flush=True)


if __name__ == "__main__":
    run_script(main)
