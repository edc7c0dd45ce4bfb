"""`make bench`: measures figures one after the other, prints each when it is done, and saves them if told to."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path

from harness.checkout import Checkout, CheckoutError
from harness.figure import Figure, Row, rows_between, rows_of, sentence
from harness.table import Progress, print_figure
from rich.console import Console

#: How often two checkouts are started anew for one figure.
SESSIONS = 3

#: Measures a figure; the second argument is told what goes on.
Measure = Callable[[Figure, Callable[[str], None]], Iterable[Row]]


@dataclass
class Results:
    """What has been measured so far; saved after every figure, so that nothing is lost."""

    path: Path | None
    about: Mapping[str, str]
    rows: list[dict[str, object]] = field(default_factory=list)
    failed: int = 0

    def add(self, name: str, rows: Sequence[Row]) -> None:
        """Keep the rows of a figure."""
        case = ""
        for row in rows:
            case = row.case or case
            told = {n: v for n, v in asdict(row).items() if n not in ("samples", "case")}
            self.rows.append({"figure": name, "case": case} | told | row.numbers() | {"count": len(row.samples)})
        self.failed += sum(bool(row.error) for row in rows)
        if self.path is not None:
            saved = {"format": 1, **self.about, "rows": self.rows}
            self.path.write_text(json.dumps(saved, indent=1) + "\n", encoding="utf-8")


def main(modules: Mapping[str, str], words: Sequence[str], out: Console | None = None) -> int:
    """Measure and print; `modules` has the module of each figure. Returns the exit status."""
    parser = argparse.ArgumentParser(prog="make bench", description="Prints the figures of lfield.")
    parser.add_argument("--only", metavar="NAMES", default="", help="some of " + ", ".join(modules))
    parser.add_argument("--save", metavar="FILE", type=Path, help="also write the rows as JSON")
    parser.add_argument("--against", metavar="CHECKOUT", type=Path, help="compare with another checkout")
    args = parser.parse_args(words)
    names = args.only.replace(",", " ").split() or list(modules)
    unknown = [name for name in names if name not in modules]
    if unknown:
        print(f"there is no figure '{unknown[0]}'; there are {', '.join(modules)}", file=sys.stderr)
        return 64
    own = Checkout.own()
    try:
        other = Checkout.at(args.against) if args.against else None
    except CheckoutError as error:
        print(error, file=sys.stderr)
        return 66
    about = {"checkout": own.commit, "python": platform.python_version(), "machine": platform.machine()}
    if other is not None:
        about |= {"against": other.commit}
    results = Results(args.save, about)
    # A pipe has no width of its own: a cut table would be of no use to anybody.
    console = out or (Console() if sys.stdout.isatty() else Console(width=140))
    console.print("   ".join(f"{name} {value}" for name, value in about.items()), highlight=False)
    try:
        for name in names:
            _figure(name, modules[name], own, other, bool(args.only), console, results)
    except KeyboardInterrupt:
        print("interrupted: what is above is all that was measured", file=sys.stderr)
        return 130
    if results.failed:
        print(f"{results.failed} of {len(results.rows)} rows could not be measured", file=sys.stderr)
        return 1
    return 0


def _figure(
    name: str, module: str, own: Checkout, other: Checkout | None, asked: bool, out: Console, results: Results
) -> None:
    """Measure, print and keep one figure; what goes wrong is a row of it."""
    start, rows = time.monotonic(), []
    title, notes, interrupted = name, (), False
    with Progress(name) as progress:
        try:
            figure: Figure = import_module(module).FIGURE
            title, notes = figure.title, figure.notes
            if other is None:
                found = rows_of(figure, own, progress.tick)
            elif figure.between:
                found = rows_between(figure, own, other, SESSIONS, progress.tick)
            else:
                found = [Row("", name, error="it is not one that two checkouts can be compared by")] if asked else []
            for row in found:
                rows.append(row)
        except KeyboardInterrupt:
            interrupted = True
        except Exception as error:
            rows.append(Row("", name, error=sentence(error)))
    if rows:
        print_figure(out, name, title, rows, (*notes, f"make bench ONLY={name}   ({time.monotonic() - start:.0f} s)"))
        results.add(name, rows)
    if interrupted:
        raise KeyboardInterrupt
