"""Prints the figures of lfield as one table: `python tests/benchmarks/run.py [NAME...]`, all by default.

Needs the extra `bench` (Pyro5, RPyC, gRPC) for `remote`, and Linux.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec

import agreement
import collector
import compiling
import compositions
import deadman
import directory
import engine
import footprint
import local
import mavlink
import offers
import query
import remote
from harness import Figure
from rich.console import Console
from rich.table import Table

import drivers

FIGURES: dict[str, Callable[[], Figure]] = {
    "remote": remote.figure,
    "local": local.figure,
    "query": query.figure,
    "engine": engine.figure,
    "collector": collector.figure,
    "agreement": agreement.figure,
    "footprint": footprint.figure,
    "deadman": deadman.figure,
    "drivers": drivers.figure,
    "mavlink": mavlink.figure,
    "directory": directory.figure,
    "offers": offers.figure,
    "compositions": compositions.figure,
    "compiling": compiling.figure,
}
#: What the extra `bench` brings.
LIBRARIES = ("Pyro5", "rpyc", "grpc")
COLUMNS = ("CASE", "MEASURED", "MEDIAN", "P99", "RATIO", "TARGET")


def main() -> int:
    """Measure and print; returns the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"one of {', '.join(FIGURES)}")
    names: list[str] = parser.parse_args().names or list(FIGURES)
    for name in names:
        if name not in FIGURES:
            parser.error(f"there is no figure '{name}'; there are {', '.join(FIGURES)}")
    lacking = [module for module in LIBRARIES if "remote" in names and find_spec(module) is None]
    if lacking:
        print(
            f"remote compares with {', '.join(lacking)}: pip install -e '.[bench]', or make bench",
            file=sys.stderr,
        )
        return 69
    table = Table(box=None, pad_edge=False)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column in ("CASE", "MEASURED") else "right")
    progress = Console(stderr=True)
    for name in names:
        start = time.monotonic()
        with progress.status(f"measuring {name}"):
            measured = FIGURES[name]()
        _add(table, name, measured, time.monotonic() - start)
    # A pipe has no width of its own: a cut table would be of no use to anybody.
    console = Console() if sys.stdout.isatty() else Console(width=120)
    console.print(table)
    return 0


def _add(table: Table, name: str, measured: Figure, seconds: float) -> None:
    """A figure as a section of the table: its title, its rows, how it was made."""
    table.add_row()
    table.add_row(f"[bold]{name}[/bold]", f"[bold]{measured.title}[/bold]")
    for row in measured.rows:
        table.add_row(row.case, row.measured, row.median, row.p99, row.ratio, row.target)
    for note in (*measured.notes, f"python tests/benchmarks/run.py {name}   ({seconds:.0f} s)"):
        table.add_row("", f"[dim]{note}[/dim]")


if __name__ == "__main__":
    sys.exit(main())
