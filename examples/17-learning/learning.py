"""Measures the gain of sharing experience: a team whose pickers learn alone, and teams that share.

`python examples/17-learning/learning.py` prints a table; with `--write` it also draws learning.svg.
"""

from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from lfield.testing.mission.mission_team import MissionTeam
from lfield.testing.script import run_script

HERE = Path(__file__).parent
#: The number of shifts, of parts that a picker picks in a shift, and of runs with different belts.
SHIFTS, PARTS, RUNS = 30, 20, 5
#: Rows and curves: number of pickers, whether they share, colour (Okabe and Ito, 2008).
TEAMS = ((4, False, "#d55e00"), (2, True, "#e69f00"), (4, True, "#009e73"), (8, True, "#0072b2"))
#: The share of held parts at which a team counts as trained.
TRAINED = 0.8
#: Pixels: size of the drawing, and margin.
WIDTH, HEIGHT, MARGIN = 640.0, 340.0, 48.0


@dataclass(frozen=True)
class TeamResult:
    """The share of parts that a team held in each shift, and its hops."""

    name: str
    colour: str
    held: Sequence[float]
    hops: int

    @property
    def parts_until_trained(self) -> int | None:
        """The parts that each picker picks until the average of three shifts is TRAINED."""
        shifts = (n for n in range(len(self.held) - 2) if mean(self.held[n : n + 3]) >= TRAINED)
        first = next(shifts, None)
        return None if first is None else first * PARTS


def run(pickers: int, shares: bool, seed: int) -> tuple[list[float], int]:
    """Runs one team; returns the share of parts that held in each shift, and the hops."""
    lines = [f"//Picker:p{n}@h{n}?{1000 * seed + 103 * n + 1}" for n in range(pickers)]
    mode = "share" if shares else "alone"
    lines.append(f"//Teacher:teacher@h0?{SHIFTS}&{mode}")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "mission.L").write_bytes((HERE / "mission.L").read_bytes())
        (Path(folder) / "mission.dL").write_text("\n".join(lines) + "\n", encoding="utf-8")
        team = MissionTeam(Path(folder) / "mission.dL", keeps=False)
        try:
            team.run(until_done=True)
            matches = [re.search(r"shift \d+: (\d+) of (\d+)", line.text) for line in team.log]
            return [int(match[1]) / int(match[2]) for match in matches if match], len(team.hops)
        finally:
            team.close()


def measure() -> list[TeamResult]:
    """Runs all teams; each result is the average of runs with different belts."""
    results = []
    for pickers, shares, colour in TEAMS:
        runs = [run(pickers, shares, seed) for seed in range(RUNS)]
        held = [mean(shift) for shift in zip(*(shifts for shifts, _ in runs), strict=True)]
        name = f"{pickers} pickers that share" if shares else f"{pickers} pickers, each alone"
        results.append(TeamResult(name, colour, held, runs[0][1]))
    return results


def table(results: Sequence[TeamResult]) -> str:
    """The table of README.md."""
    rows = [
        "| team | parts of a picker until 80 % hold | held in the first 200 | in the next 400 | hops |",
        "|---|---:|---:|---:|---:|",
    ]
    for team in results:
        early, late = mean(team.held[: 200 // PARTS]), mean(team.held[200 // PARTS :])
        rows.append(f"| {team.name} | {team.parts_until_trained} | {early:.0%} | {late:.0%} | {team.hops} |")
    return "\n".join(rows)


def draw(results: Sequence[TeamResult]) -> str:
    """An SVG of the share of parts that held, over the number of parts that each picker has picked."""
    right, bottom = WIDTH - MARGIN, HEIGHT - MARGIN
    parts = []
    for percent in range(0, 101, 20):
        y = _y(percent / 100)
        parts.append(f'<path d="M{MARGIN} {y:.1f}H{right}" stroke="#ddd"/>')
        parts.append(_text(MARGIN - 36, y + 4, f"{percent} %"))
    for count in range(0, SHIFTS * PARTS + 1, 100):
        parts.append(_text(_x(count / PARTS) - 8, bottom + 18, str(count)))
    parts.append(_text(MARGIN, bottom + 38, "parts that each picker has picked"))
    parts.append(_text(MARGIN, 24, f"parts that held, average of {RUNS} runs"))
    for n, team in enumerate(results):
        points = " ".join(f"{_x(shift + 1):.1f},{_y(share):.1f}" for shift, share in enumerate(team.held))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{team.colour}"/>')
        parts.append(_text(right - 170, bottom - 80 + 18 * n, team.name, team.colour))
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" width="{WIDTH:.0f}" '
        'font-family="sans-serif" font-size="12" stroke-width="2">\n'
        f'<rect width="100%" height="100%" fill="#fff"/>\n{body}\n</svg>\n'
    )


def _x(shift: float) -> float:
    return MARGIN + shift / SHIFTS * (WIDTH - 2 * MARGIN)


def _y(share: float) -> float:
    return HEIGHT - MARGIN - share * (HEIGHT - 2 * MARGIN)


def _text(x: float, y: float, text: str, colour: str = "#222") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" fill="{colour}" stroke="none">{text}</text>'


def main() -> None:
    """Prints the table, and draws the picture if required."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="draw learning.svg")
    args = parser.parse_args()
    results = measure()
    if args.write:
        (HERE / "learning.svg").write_text(draw(results), encoding="utf-8")
    print(table(results))


if __name__ == "__main__":
    run_script(main)
