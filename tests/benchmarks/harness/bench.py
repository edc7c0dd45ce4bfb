"""`make bench`: measures the figures in sequence and prints each when it is complete."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path

from harness.checkout import Checkout, CheckoutError
from harness.figure import Figure, Row, rows_between, rows_of
from harness.picture import Pictured, caption, draw, fields_of
from harness.samples import Tick, sentence
from harness.table import Progress, print_figure
from rich.console import Console

#: Restarts of all processes of two checkouts for a figure.
SESSIONS = 3


@dataclass
class Bench:
    """A run of `make bench`, with its rows so far; the rows are saved after every figure."""

    own: Checkout
    other: Checkout | None
    out: Console
    path: Path | None
    #: Rounds of each figure; 0 selects the figure's own number.
    rounds: int
    kept: list[dict[str, object]] = field(default_factory=list)
    failed: int = 0

    @property
    def about(self) -> dict[str, str]:
        """Facts about the rows: the measured checkouts, and the version of Python."""
        against = {"against": self.other.commit} if self.other is not None else {}
        return {"checkout": self.own.commit, **against, "python": platform.python_version()}

    def measure(self, name: str, module: str) -> None:
        """Measure, print and save one figure; an exception becomes a row of it."""
        start, rows, figure = time.monotonic(), [], Figure("", {})
        try:
            with Progress(name) as progress:
                figure = import_module(module).FIGURE
                figure = replace(figure, rounds=self.rounds or figure.rounds)
                for row in self._rows(figure, progress.tick):
                    rows.append(row)
                    progress.row(row)
        except Exception as error:
            rows.append(Row("", name, error=sentence(error)))
        finally:
            summary = f"make bench ONLY={name}   ({time.monotonic() - start:.0f} s)"
            if rows:
                title = figure.title if self.other is None else figure.title.partition(";")[0]
                print_figure(self.out, name, title, rows, (*figure.notes, summary))
            self._keep(name, rows)

    def _rows(self, figure: Figure, tick: Tick) -> Iterable[Row]:
        if self.other is None:
            return rows_of(figure, self.own, tick)
        if not figure.between:
            self.out.print("\nnot compared, as it uses the modules of one checkout:", figure.title)
        return rows_between(figure, self.own, self.other, SESSIONS, tick)

    def picture(self, pictured: Mapping[str, Pictured]) -> str:
        """A drawing of the rows so far. Raises ValueError if none of them can be drawn."""
        return draw(fields_of(self.kept, pictured), caption(self.about))

    def _keep(self, name: str, rows: Sequence[Row]) -> None:
        case = ""
        for row in rows:
            case = row.case or case
            fields = {key: value for key, value in asdict(row).items() if key not in ("samples", "case")}
            counted = {"count": len(row.samples), **row.numbers()}
            self.kept.append({"figure": name, "case": case, **fields, **counted})
        self.failed += sum(bool(row.error) for row in rows)
        if self.path is not None:
            saved = {"format": 1, **self.about, "rows": self.kept}
            self.path.write_text(json.dumps(saved, indent=1) + "\n", encoding="utf-8")


def main(
    modules: Mapping[str, str],
    words: Sequence[str],
    out: Console | None = None,
    pictured: Mapping[str, Pictured] | None = None,
) -> int:
    """Measure and print; `modules` has the module of each figure, `pictured` the figures of the picture.

    Returns the exit status.
    """
    parser = argparse.ArgumentParser(prog="make bench", description="Prints the figures of lfield.")
    parser.add_argument("--only", metavar="NAMES", default="", help=f"some of {', '.join(modules)}")
    parser.add_argument("--save", metavar="FILE", type=Path, help="also write the rows as JSON")
    parser.add_argument("--picture", metavar="FILE", type=Path, help="also draw those with sizes, an SVG")
    parser.add_argument("--against", metavar="CHECKOUT", type=Path, help="compare with another checkout")
    parser.add_argument("--rounds", metavar="N", type=int, default=0, help="as many of each figure")
    args = parser.parse_args(words)
    names = args.only.replace(",", " ").split() or list(modules)
    for name in names:
        if name not in modules:
            print(f"there is no figure '{name}'; there are {', '.join(modules)}", file=sys.stderr)
            return 64
    try:
        other = Checkout.at(args.against) if args.against else None
    except CheckoutError as error:
        print(error, file=sys.stderr)
        return 66
    # A pipe has no width; the default would cut the table.
    console = out or Console(width=None if sys.stdout.isatty() else 150)
    bench = Bench(Checkout.own(), other, console, args.save, args.rounds)
    bench.out.print("   ".join(f"{name} {value}" for name, value in bench.about.items()), highlight=False)
    try:
        for name in names:
            bench.measure(name, modules[name])
    except KeyboardInterrupt:
        print("interrupted: what is above is all that was measured", file=sys.stderr)
        return 130
    if args.picture is not None:
        args.picture.write_text(bench.picture(pictured or {}), encoding="utf-8")
    if bench.failed:
        print(f"{bench.failed} of {len(bench.kept)} rows could not be measured", file=sys.stderr)
        return 1
    return 0
