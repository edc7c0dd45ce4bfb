"""Runs hunts in different worlds: numbers of robots and prey, sizes, legal moves, intelligence of the prey.

`python examples/22-predators/hunt_statistics.py` prints a table; `--runs N` sets the hunts of each row.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.script import run_script

HERE = Path(__file__).parent
#: Each row: title, and the world of the plane (`world.py` of the arena).
WORLDS: tuple[tuple[str, str], ...] = (
    ("four predators, open plane", ""),
    ("prey stands still", "mind=still"),
    ("prey moves at random", "mind=random"),
    ("prey flees from the nearest one", "mind=away"),
    ("three predators", "predators=3"),
    ("five predators", "predators=5"),
    ("six predators", "predators=6"),
    ("predators move along the axes", "moves=4"),
    ("prey moves along the axes", "prey_moves=4"),
    ("both move along the axes", "moves=4 prey_moves=4"),
    ("walls, 6 m", "size=6"),
    ("walls, 12 m", "size=12"),
    ("two prey", "prey=2"),
    ("three prey", "prey=3"),
    ("three prey, six predators, walls, 8 m", "prey=3 predators=6 size=8"),
)
#: Hunts of each row, with different positions of the prey; maximum seconds for each prey of a hunt.
RUNS, TIME_PER_PREY = 5, 300.0


@dataclass(frozen=True)
class HuntResult:
    """Numbers of caught prey, of all prey, of steps and of hops."""

    caught: int
    prey: int
    steps: int
    hops: int


def hunt(world: str, seed: int) -> HuntResult:
    """Runs one hunt in a world."""
    seeded_world = f"{world} seed={seed}".strip()
    predators, prey = _number(world, "predators", 4), _number(world, "prey", 1)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        (copy / "mission.L").write_bytes((HERE / "mission.L").read_bytes())
        (copy / "mission.dL").write_text(_deployment(predators), encoding="utf-8")
        (copy / "mission.devices.yaml").write_text(_devices(predators, seeded_world), encoding="utf-8")
        team = MissionTeam(copy / "mission.dL", seed=seed, keeps=False)
        try:
            team.run(until_done=True, at_most=TIME_PER_PREY * prey)
            (line,) = [line.text for line in team.log if " steps and " in line.text]
        finally:
            team.close()
    steps, hops = map(int, re.findall(r"after (\d+) steps and (\d+) hops", line)[0])
    escaped = re.search(r"(\d+) of \d+ got away", line)
    caught = prey if "caught by" in line else prey - int(escaped[1]) if escaped else 0
    return HuntResult(caught, prey, steps, hops)


def _number(world: str, name: str, default: int) -> int:
    match = re.search(rf"\b{name}=(\d)", world)
    return int(match[1]) if match else default


def _deployment(predators: int) -> str:
    lines = [f"//Rover:p{n}@h{n}\n" for n in range(1, predators + 1)]
    return "".join([*lines, "//Hunt:hunt@h1\n"])


def _devices(predators: int, world: str) -> str:
    rows = [
        f'  p{n}: {{devices: {{wheels: {{driver: arena, endpoint: "tcp:127.0.0.1:{7200 + n}", plane: hunt, '
        f'robot: {n}, world: "{world}", limits: {{radius: 30.0}}}}}}}}\n'
        for n in range(1, predators + 1)
    ]
    return "".join(["unreachable_after: 1\nagents:\n", *rows])


def table_row(name: str, hunts: Sequence[HuntResult]) -> str:
    """A row of the table; steps and hops are medians of the hunts in which all prey were caught."""
    caught, prey = sum(hunt.caught for hunt in hunts), sum(hunt.prey for hunt in hunts)
    complete = [hunt for hunt in hunts if hunt.caught == hunt.prey]
    steps = f"{median(hunt.steps / hunt.prey for hunt in complete):.0f}" if complete else "-"
    hops = f"{median(hunt.hops / hunt.prey for hunt in complete):.0f}" if complete else "-"
    return f"| {name} | {caught} of {prey} | {steps} | {hops} |"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("names", nargs="*", help="print only rows whose name contains one of these texts")
    args = parser.parse_args()
    worlds = [
        (name, world) for name, world in WORLDS if not args.names or any(part in name for part in args.names)
    ]
    if args.runs < 1 or not worlds:
        parser.error("--runs must be at least 1, and a row must contain one of the texts")
    print("| world | caught | steps per prey | hops per prey |\n|---|---:|---:|---:|")
    for name, world in worlds:
        print(table_row(name, [hunt(world, seed) for seed in range(args.runs)]), flush=True)


if __name__ == "__main__":
    run_script(main)
