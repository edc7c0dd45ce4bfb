"""Output of figures: a table for each on stdout, progress on stderr."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from harness.figure import Row
from harness.number_text import number_text, times
from rich.console import Console
from rich.progress import Progress as Bar
from rich.progress import SpinnerColumn, TextColumn
from rich.table import Table
from rich.text import Text

#: Column widths, equal in the tables of all figures.
COLUMNS = {
    "CASE": 36,
    "MEASURED": 30,
    "N": 5,
    "MIN": 9,
    "MEDIAN": 9,
    "P90": 9,
    "P99": 9,
    "MAX": 9,
    "RATIO": 6,
    "TARGET": 10,
}


class Progress:
    """A progress line, erased at the end; without a thread, which would disturb the measurement."""

    def __init__(self, name: str) -> None:
        columns = SpinnerColumn(), TextColumn("{task.description}")
        console = Console(stderr=True)
        self._bar = Bar(
            *columns, console=console, transient=True, auto_refresh=False, disable=not console.is_terminal
        )
        self._name = name
        self._task = self._bar.add_task(name)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def row(self, row: Row) -> None:
        """Print a measured row immediately; the table follows at the end."""
        self._bar.console.print(Text("   ".join(filter(None, _cells(row))), style="dim"), soft_wrap=True)

    def tick(self, text: str) -> None:
        """Show the progress of a measurement."""
        self._bar.update(self._task, description=f"{self._name}: {text}", refresh=True)


def print_figure(out: Console, name: str, title: str, rows: Sequence[Row], notes: Sequence[str]) -> None:
    """Print the title, the rows and the notes of a figure."""
    out.print()
    out.print(Text(name, style="bold"), Text(title), soft_wrap=True)
    table = Table(box=None, pad_edge=False)
    for column, width in COLUMNS.items():
        table.add_column(
            column,
            min_width=width,
            justify="left" if column in ("CASE", "MEASURED") else "right",
            overflow="fold",
        )
    for row in rows:
        if not row.error:
            table.add_row(*map(Text, _cells(row)))
    out.print(table)
    for row in rows:
        if row.error:
            out.print(Text(f"{row.case} {row.measured}: {row.error}".strip(), style="red"), soft_wrap=True)
    for note in notes:
        out.print(Text(note, style="dim"), soft_wrap=True)


def _cells(row: Row) -> tuple[str, ...]:
    numbers = [number_text(number, row.unit) for number in row.numbers().values()] or [""] * 5
    count = str(len(row.samples) or "")
    ratio = "" if row.ratio is None else times(row.ratio)
    return row.case, row.measured, count, *numbers, ratio, row.target
