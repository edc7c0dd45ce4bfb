"""Matches of two programs in real time: two missions, each with program, bundle and hosts, and one referee.

`python examples/23-soccer/league.py` prints a table; `--matches N` and `--seconds S` set number and length.
"""

from __future__ import annotations

import argparse
import re
import socket
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
#: The two programs, and their matches.
PROGRAMS, MATCHES, SECONDS = ("red", "blue"), 3, 60.0
#: Seconds for both missions to start and end.
PATIENCE = 120.0


@dataclass(frozen=True)
class Score:
    """The end of a match for one program: goals in the north and in the south, as its coach has them from the
    referee; its hops.
    """

    north: int
    south: int
    hops: int


def match(seconds: float) -> list[Score]:
    """One match: both missions are started as processes, and meet at the referee."""
    world = f"referee=1 port={_free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        for path in HERE.iterdir():
            if path.suffix in (".L", ".dL", ".yaml"):
                text = path.read_text(encoding="utf-8").replace("?60&", f"?{seconds:g}&")
                text = text.replace("referee=1", world)
                (Path(folder) / path.name).write_text(text, encoding="utf-8")
        running = [_mission(Path(folder) / f"{name}.dL") for name in PROGRAMS]
        try:
            return [_score(one.communicate(timeout=seconds + PATIENCE)[0]) for one in running]
        finally:
            for one in running:
                if one.poll() is None:
                    one.kill()
                    one.communicate()


def _free_port() -> int:
    """A port for the pitch that both missions share: leagues can run side by side."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def _mission(deployment: Path) -> subprocess.Popen[str]:
    command = ["-m", "lfield", "up", "--deploy", str(deployment), "--all", "--sim", "--until-done"]
    return subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def _score(log: str) -> Score:
    counts = re.search(r"counts (\d+) in the north, (\d+) in the south", log)
    hops = re.search(r"(\d+) hops", log)
    if counts is None or hops is None:
        sys.exit(f"a mission has not come to the end of the match:\n{log[-2000:]}")
    return Score(int(counts[1]), int(counts[2]), int(hops[1]))


def row(number: int, scores: Sequence[Score]) -> str:
    """A row of the table: goals of the reds, who play to the north, and of the blues; hops of both."""
    red, blue = scores
    return f"| {number} | {red.north}:{red.south} | {red.hops} | {blue.hops} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matches", type=int, default=MATCHES)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    args = parser.parse_args()
    print("| match | red : blue | hops of red | hops of blue |\n|---:|---|---:|---:|")
    for number in range(1, args.matches + 1):
        print(row(number, match(args.seconds)), flush=True)


if __name__ == "__main__":
    main()
