"""Runs the march on terrain that slows rovers, and in wind that moves copters.

`python examples/20-formation/terrain_marches.py` prints the table of README.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.mission.recorders import Point
from lfield.testing.script import run_script

HERE = Path(__file__).parent
ROVERS, COPTERS = ("dan", "eve"), ("ada", "bob", "cat")
#: Seconds between two updates of the ground and wind at a vehicle.
UPDATE_INTERVAL = 0.5
#: Ground and wind at a position, north and east in metres, as settings of the simulated devices.
Terrain = Callable[[float, float], Mapping[str, float]]


def flat(north: float, east: float) -> Mapping[str, float]:
    """Firm ground and no wind."""
    return {"ground": 1.0, "wind": 0.0}


def mud(north: float, east: float) -> Mapping[str, float]:
    """A stripe of mud, 8 m wide, where rovers have 40 % of their speed."""
    return {"ground": 0.4 if 4.0 <= north <= 12.0 else 1.0, "wind": 0.0}


def hill(north: float, east: float) -> Mapping[str, float]:
    """A round hill at (12, 12) with a radius of 10 m, where rovers have down to 30 % of their speed."""
    height = max(0.0, 1.0 - math.hypot(north - 12.0, east - 12.0) / 10.0)
    return {"ground": 1.0 - 0.7 * height, "wind": 0.0}


def valley(north: float, east: float) -> Mapping[str, float]:
    """East of a ridge at 9 m: wind of 7 m/s from the west, and mud."""
    return {"ground": 0.5 if east > 9.0 else 1.0, "wind": 7.0 if east > 9.0 else 0.0}


TERRAINS: tuple[tuple[str, Terrain], ...] = (
    ("flat", flat),
    ("a stripe of mud", mud),
    ("a hill", hill),
    ("a windy valley with mud", valley),
)


@dataclass(frozen=True)
class MarchResult:
    """The robots that arrived, the duration in s, the largest distance from the centre in m, the hops."""

    arrived: int
    seconds: float
    spread: float
    hops: int


def march(terrain: Terrain) -> MarchResult:
    """Runs the march on a terrain."""
    team = MissionTeam(HERE / "mission.dL")
    try:
        for robot in COPTERS:
            team.fake(f"{robot}.fc").set("wind_from=4.7")
        while "march" not in team.ended:
            team.run(UPDATE_INTERVAL)
            for robot in (*ROVERS, *COPTERS):
                track = team.tracks[f"{robot}.fc"]
                if track:
                    conditions = terrain(track[-1].north, track[-1].east)
                    setting = "ground" if robot in ROVERS else "wind"
                    team.fake(f"{robot}.fc").set(f"{setting}={conditions[setting]:g}")
        reports = [line for line in team.log if " is at (" in line.text]
        first, last = reports[0], reports[-1]
        arrived = int(last.text.split(" of ")[1].split()[0])
        return MarchResult(arrived, last.at, _spread(team, first.at, last.at), len(team.hops))
    finally:
        team.close()


def _spread(team: MissionTeam, start: float, end: float) -> float:
    """The largest distance of a robot from the centre of all robots between two times, in metres."""
    tracks = [team.tracks[f"{robot}.fc"] for robot in (*ROVERS, *COPTERS)]
    times = [point.at for point in tracks[0] if start <= point.at <= end]
    largest = 0.0
    for time in times[::5]:
        places = [min(track, key=lambda point: abs(point.at - time)) for track in tracks]
        centre = _centre(places)
        largest = max(largest, *(math.dist((p.north, p.east), centre) for p in places))
    return largest


def _centre(places: list[Point]) -> tuple[float, float]:
    count = len(places)
    return sum(p.north for p in places) / count, sum(p.east for p in places) / count


def table_row(name: str, result: MarchResult) -> str:
    """A row of the table."""
    return (
        f"| {name} | {result.arrived} of 5 | {result.seconds:.0f} s | {result.spread:.1f} m | {result.hops} |"
    )


def main() -> None:
    """Prints the table."""
    print("| terrain | arrive | time | largest distance from the centre | hops |\n|---|---:|---:|---:|---:|")
    for name, terrain in TERRAINS:
        print(table_row(name, march(terrain)), flush=True)


if __name__ == "__main__":
    run_script(main)
