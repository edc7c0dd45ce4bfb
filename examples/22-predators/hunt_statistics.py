"""Hunts in different worlds: numbers, sizes, legal moves and intelligence of the prey.

`python examples/22-predators/hunts.py` prints a table; `--runs N` sets the number of hunts of each row.
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
#: Each row: what differs, and the world of the plane (`world.py` of the arena).
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
#: Hunts of a row, each with other places of the prey; seconds until a hunt is ended.
RUNS, PATIENCE = 5, 300.0


@dataclass(frozen=True)
class Hunt:
    """The end of a hunt: caught and all prey, steps, hops."""

    caught: int
    prey: int
    steps: int
    hops: int


def hunt(world: str, seed: int) -> Hunt:
    """One hunt in a world."""
    text = f"{world} seed={seed}".strip()
    predators, prey = _number(world, "predators", 4), _number(world, "prey", 1)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "mission.L").write_bytes((HERE / "mission.L").read_bytes())
        (place / "mission.dL").write_text(_deployment(predators), encoding="utf-8")
        (place / "mission.devices.yaml").write_text(_devices(predators, text), encoding="utf-8")
        team = MissionTeam(place / "mission.dL", seed=seed, keeps=False)
        try:
            team.run(until_done=True, at_most=PATIENCE * prey)
            (line,) = [line.text for line in team.log if " steps and " in line.text]
        finally:
            team.close()
    steps, hops = map(int, re.findall(r"after (\d+) steps and (\d+) hops", line)[0])
    left = re.search(r"(\d+) of \d+ got away", line)
    caught = prey if "caught by" in line else prey - int(left[1]) if left else 0
    return Hunt(caught, prey, steps, hops)


def _number(world: str, name: str, otherwise: int) -> int:
    found = re.search(rf"\b{name}=(\d)", world)
    return int(found[1]) if found else otherwise


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


def row(name: str, hunts: Sequence[Hunt]) -> str:
    """A row of the table: prey caught of all, and medians of the steps and hops per prey that was caught."""
    caught, prey = sum(one.caught for one in hunts), sum(one.prey for one in hunts)
    good = [one for one in hunts if one.caught == one.prey]
    steps = f"{median(one.steps / one.prey for one in good):.0f}" if good else "-"
    hops = f"{median(one.hops / one.prey for one in good):.0f}" if good else "-"
    return f"| {name} | {caught} of {prey} | {steps} | {hops} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("names", nargs="*", help="only rows with one of these texts in their names")
    args = parser.parse_args()
    worlds = [row for row in WORLDS if not args.names or any(part in row[0] for part in args.names)]
    if args.runs < 1 or not worlds:
        parser.error("--runs is at least 1, and a name is a part of a row's name")
    print("| world | caught | steps per prey | hops per prey |\n|---|---:|---:|---:|")
    for name, world in worlds:
        print(row(name, [hunt(world, seed) for seed in range(args.runs)]), flush=True)


if __name__ == "__main__":
    run_script(main)
