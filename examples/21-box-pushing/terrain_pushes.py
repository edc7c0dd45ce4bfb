"""Runs the mission on slopes and in mud, and measures the final distance of the box from its goal.

`python examples/21-box-pushing/terrain_pushes.py` prints the table of README.md.
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
#: Each row: title, and the world of the plane (`world.py`).
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
class PushResult:
    """Distance of the box from its goal in m, heading error in rad, steps, hops."""

    distance: float
    heading_error: float
    steps: int
    hops: int


def push(world: str) -> PushResult:
    """Runs the mission of the example on a terrain."""
    devices = (HERE / "mission.devices.yaml").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("mission.L", "mission.dL"):
            (copy / name).write_bytes((HERE / name).read_bytes())
        devices = re.sub(r"(robot: \d),", rf'\1, world: "{world}",', devices)
        (copy / "mission.devices.yaml").write_text(devices, encoding="utf-8")
        team = MissionTeam(copy / "mission.dL")
        try:
            team.run(until_done=True)
            (line,) = [line.text for line in team.log if "the box is at" in line.text]
        finally:
            team.close()
    north, east, heading = map(float, re.findall(r"-?\d+\.\d+", line))
    steps, hops = map(int, re.findall(r"after (\d+) steps and (\d+) hops", line)[0])
    return PushResult(math.dist((north, east), GOAL[:2]), abs(heading - GOAL[2]), steps, hops)


def table_row(name: str, result: PushResult) -> str:
    """A row of the table."""
    errors = f"{result.distance:.2f} m | {result.heading_error:.2f} rad"
    return f"| {name} | {errors} | {result.steps} | {result.hops} |"


def main() -> None:
    """Prints the table."""
    print("| terrain | distance from the goal | heading error | steps | hops |\n|---|---:|---:|---:|---:|")
    for name, world in TERRAINS:
        print(table_row(name, push(world)), flush=True)


if __name__ == "__main__":
    run_script(main)
