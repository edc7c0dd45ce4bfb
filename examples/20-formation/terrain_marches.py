"""Marches over terrain that slows rovers, and through wind that moves copters.

`python examples/20-formation/terrain_marches.py` prints a table.
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
#: Seconds between two looks at the ground below a vehicle.
STEP = 0.5
#: What the ground and the air at a place are: faults of the simulated devices, by north and east in metres.
Terrain = Callable[[float, float], Mapping[str, float]]


def flat(north: float, east: float) -> Mapping[str, float]:
    """Firm ground and no wind."""
    return {"ground": 1.0, "wind": 0.0}


def mud(north: float, east: float) -> Mapping[str, float]:
    """A stripe of mud, 8 m wide, in which rovers have 40 % of their speed."""
    return {"ground": 0.4 if 4.0 <= north <= 12.0 else 1.0, "wind": 0.0}


def hill(north: float, east: float) -> Mapping[str, float]:
    """A round hill at (12, 12) with a radius of 10 m: the nearer to its top, the slower are rovers."""
    height = max(0.0, 1.0 - math.hypot(north - 12.0, east - 12.0) / 10.0)
    return {"ground": 1.0 - 0.7 * height, "wind": 0.0}


def valley(north: float, east: float) -> Mapping[str, float]:
    """Wind of 7 m/s from the west with gusts, east of a ridge at 9 m, and mud behind it."""
    return {"ground": 0.5 if east > 9.0 else 1.0, "wind": 7.0 if east > 9.0 else 0.0}


TERRAINS: tuple[tuple[str, Terrain], ...] = (
    ("flat", flat),
    ("a stripe of mud", mud),
    ("a hill", hill),
    ("a windy valley with mud", valley),
)


@dataclass(frozen=True)
class March:
    """A march: how many arrived, its end in s, the greatest distance from the middle in m, hops."""

    arrived: int
    seconds: float
    spread: float
    hops: int


def march(terrain: Terrain, seed: int = 0) -> March:
    """The march of the example on a terrain."""
    team = MissionTeam(HERE / "mission.dL", seed=seed)
    try:
        for who in COPTERS:
            team.fake(f"{who}.fc").set("wind_from=4.7")
        while "march" not in team.ended:
            team.run(STEP)
            for who in (*ROVERS, *COPTERS):
                track = team.tracks[f"{who}.fc"]
                if track:
                    here = terrain(track[-1].north, track[-1].east)
                    kind = "ground" if who in ROVERS else "wind"
                    team.fake(f"{who}.fc").set(f"{kind}={here[kind]:g}")
        reports = [line for line in team.log if " is at (" in line.text]
        first, last = reports[0], reports[-1]
        many = int(last.text.split(" of ")[1].split()[0])
        return March(many, last.at, _spread(team, first.at, last.at), len(team.hops))
    finally:
        team.close()


def _spread(team: MissionTeam, since: float, until: float) -> float:
    """The greatest distance of a vehicle from the middle of all, while they march, in metres."""
    tracks = [team.tracks[f"{who}.fc"] for who in (*ROVERS, *COPTERS)]
    times = [point.at for point in tracks[0] if since <= point.at <= until]
    most = 0.0
    for moment in times[::5]:
        places = [min(track, key=lambda point: abs(point.at - moment)) for track in tracks]
        middle = _middle(places)
        most = max(most, *(math.dist((p.north, p.east), middle) for p in places))
    return most


def _middle(places: list[Point]) -> tuple[float, float]:
    count = len(places)
    return sum(p.north for p in places) / count, sum(p.east for p in places) / count


def row(name: str, found: March) -> str:
    """A row of the table."""
    return f"| {name} | {found.arrived} of 5 | {found.seconds:.0f} s | {found.spread:.1f} m | {found.hops} |"


def main() -> None:
    """Print the table."""
    print("| terrain | arrive | time | farthest from the middle | hops |\n|---|---:|---:|---:|---:|")
    for name, terrain in TERRAINS:
        print(row(name, march(terrain)), flush=True)


if __name__ == "__main__":
    run_script(main)
