"""Runs matches of two programs in real time: each program is a mission with its own bundle and hosts.

`python examples/23-soccer/league.py` prints a table; `--matches N` and `--seconds S` set number and duration.
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
#: The two programs; number and duration of the matches.
PROGRAMS, MATCHES, SECONDS = ("red", "blue"), 3, 60.0
#: Seconds: maximum time for the start and the end of both missions.
OVERHEAD = 120.0


@dataclass(frozen=True)
class MatchResult:
    """Goals in the north and in the south, as reported by one coach, and the hops of that coach."""

    north: int
    south: int
    hops: int


def match(seconds: float) -> list[MatchResult]:
    """Runs one match with processes for both missions; returns the results of both programs."""
    world = f"referee=1 port={_free_port()}"
    with tempfile.TemporaryDirectory() as folder:
        for path in HERE.iterdir():
            if path.suffix in (".L", ".dL", ".yaml"):
                text = path.read_text(encoding="utf-8").replace("?60&", f"?{seconds:g}&")
                text = text.replace("referee=1", world)
                (Path(folder) / path.name).write_text(text, encoding="utf-8")
        missions = [_start(Path(folder) / f"{name}.dL") for name in PROGRAMS]
        try:
            return [_result(mission.communicate(timeout=seconds + OVERHEAD)[0]) for mission in missions]
        finally:
            for mission in missions:
                if mission.poll() is None:
                    mission.kill()
                    mission.communicate()


def _free_port() -> int:
    """A free port for the pitch, which both missions share."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def _start(deployment: Path) -> subprocess.Popen[str]:
    command = ["-m", "lfield", "up", "--deploy", str(deployment), "--all", "--sim", "--until-done"]
    return subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def _result(log: str) -> MatchResult:
    counts = re.search(r"counts (\d+) in the north, (\d+) in the south", log)
    hops = re.search(r"(\d+) hops", log)
    if counts is None or hops is None:
        sys.exit(f"a mission ended before the end of the match:\n{log[-2000:]}")
    return MatchResult(int(counts[1]), int(counts[2]), int(hops[1]))


def table_row(number: int, results: Sequence[MatchResult]) -> str:
    """A row of the table: goals of red, which plays to the north, and of blue; hops of both."""
    red, blue = results
    return f"| {number} | {red.north}:{red.south} | {red.hops} | {blue.hops} |"


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--matches", type=int, default=MATCHES)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    args = parser.parse_args()
    print("| match | red : blue | hops of red | hops of blue |\n|---:|---|---:|---:|")
    for number in range(1, args.matches + 1):
        print(table_row(number, match(args.seconds)), flush=True)


if __name__ == "__main__":
    main()
