"""Measures what sharing gains: teams that learn alone, and teams of different sizes that share.

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
#: The number of shifts, the parts that a picker picks in one, and the belts that are averaged.
SHIFTS, PARTS, BELTS = 30, 20, 5
#: The rows and curves: pickers, and whether they share; with colours of Okabe and Ito (2008).
TEAMS = ((4, False, "#d55e00"), (2, True, "#e69f00"), (4, True, "#009e73"), (8, True, "#0072b2"))
#: The share of parts that counts as learnt.
GOOD = 0.8
#: Pixels: size of the picture, and margin.
WIDTH, HEIGHT, MARGIN = 640.0, 340.0, 48.0


@dataclass(frozen=True)
class Learnt:
    """What a team has learnt: by shift, the share of parts that held; and its hops."""

    name: str
    colour: str
    held: Sequence[float]
    hops: int

    @property
    def parts(self) -> int | None:
        """How many parts a picker has picked until four fifths hold, on average of three shifts."""
        good = (n for n in range(len(self.held) - 2) if mean(self.held[n : n + 3]) >= GOOD)
        first = next(good, None)
        return None if first is None else first * PARTS


def run(pickers: int, shares: bool, belts: int) -> tuple[list[float], int]:
    """One team with belts of its own: the share of parts that held in each shift, and the hops."""
    lines = [f"//Picker:p{n}@h{n}?{1000 * belts + 103 * n + 1}" for n in range(pickers)]
    how = "share" if shares else "alone"
    lines.append(f"//Teacher:teacher@h0?{SHIFTS}&{how}")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "mission.L").write_bytes((HERE / "mission.L").read_bytes())
        (Path(folder) / "mission.dL").write_text("\n".join(lines) + "\n", encoding="utf-8")
        team = MissionTeam(Path(folder) / "mission.dL", keeps=False)
        try:
            team.run(until_done=True)
            found = [re.search(r"shift \d+: (\d+) of (\d+)", line.text) for line in team.log]
            return [int(one[1]) / int(one[2]) for one in found if one], len(team.hops)
        finally:
            team.close()


def measured(belts: int = BELTS) -> list[Learnt]:
    """All teams, each averaged over runs with other belts."""
    learnt = []
    for pickers, shares, colour in TEAMS:
        runs = [run(pickers, shares, number) for number in range(belts)]
        held = [mean(shift) for shift in zip(*(one for one, _ in runs), strict=True)]
        name = f"{pickers} pickers that share" if shares else f"{pickers} pickers, each alone"
        learnt.append(Learnt(name, colour, held, runs[0][1]))
    return learnt


def table(learnt: Sequence[Learnt]) -> str:
    """The rows of the README."""
    rows = [
        "| team | parts of a picker until 80 % hold | held in the first 200 | in the next 400 | hops |",
        "|---|---:|---:|---:|---:|",
    ]
    for one in learnt:
        early, late = mean(one.held[: 200 // PARTS]), mean(one.held[200 // PARTS :])
        rows.append(f"| {one.name} | {one.parts} | {early:.0%} | {late:.0%} | {one.hops} |")
    return "\n".join(rows)


def draw(learnt: Sequence[Learnt]) -> str:
    """An SVG: the share of parts that held, over the parts that each picker has picked."""
    right, bottom = WIDTH - MARGIN, HEIGHT - MARGIN
    parts = []
    for percent in range(0, 101, 20):
        y = _y(percent / 100)
        parts.append(f'<path d="M{MARGIN} {y:.1f}H{right}" stroke="#ddd"/>')
        parts.append(_text(MARGIN - 36, y + 4, f"{percent} %"))
    for count in range(0, SHIFTS * PARTS + 1, 100):
        parts.append(_text(_x(count / PARTS) - 8, bottom + 18, str(count)))
    parts.append(_text(MARGIN, bottom + 38, "parts that each picker has picked"))
    parts.append(_text(MARGIN, 24, f"parts that held, average of {BELTS} runs"))
    for n, one in enumerate(learnt):
        points = " ".join(f"{_x(shift + 1):.1f},{_y(share):.1f}" for shift, share in enumerate(one.held))
        parts.append(f'<polyline points="{points}" fill="none" stroke="{one.colour}"/>')
        parts.append(_text(right - 170, bottom - 80 + 18 * n, one.name, one.colour))
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
    """Print the table, and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="draw learning.svg")
    args = parser.parse_args()
    learnt = measured()
    if args.write:
        (HERE / "learning.svg").write_text(draw(learnt), encoding="utf-8")
    print(table(learnt))


if __name__ == "__main__":
    run_script(main)
