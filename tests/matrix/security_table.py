"""The security matrix (security.yaml) as cells, and as the page of the documentation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import yaml

HERE = Path(__file__).parent
TABLE, PAGE = HERE / "security.yaml", HERE.parents[1] / "lfield" / "docs" / "security-matrix.md"
#: Marks on the page: done, refused, and deviations from the intention.
SHOWN = {"y": "yes", "n": "–", "!": "**yes, not yet refused**", "?": "**–, not yet done**"}


@dataclass(frozen=True, slots=True)
class Cell:
    """An action of a peer over a path; `done` states whether it should be accepted."""

    way: str
    who: str
    what: str
    done: bool
    #: Whether this is so today.
    kept: bool

    @property
    def name(self) -> str:
        """The name of the cell in a list of cells."""
        return f"{self.way}-{self.who}-{self.what}"


@dataclass(frozen=True, slots=True)
class Way:
    """An access path to a host: the texts of its columns and rows, and the cells."""

    name: str
    title: str
    text: str
    columns: Mapping[str, str]
    rows: Mapping[str, tuple[str, str]]

    def cells(self) -> Iterator[Cell]:
        """Every cell, row by row."""
        for role, (_, marks) in self.rows.items():
            for what, mark in zip(self.columns, marks, strict=True):
                yield Cell(self.name, role, what, done=mark in "y?", kept=mark in "yn")


@cache
def ways() -> tuple[Way, ...]:
    """The table."""
    read = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return tuple(
        Way(
            name,
            table["title"],
            table["text"],
            table["columns"],
            {role: (row[0], row[1].replace(" ", "")) for role, row in table["rows"].items()},
        )
        for name, table in read.items()
    )


def cells() -> list[Cell]:
    """Every cell of every way."""
    return [cell for way in ways() for cell in way.cells()]


def page() -> str:
    """The table as a page in Markdown."""
    every = cells()
    lines = [
        "# The security matrix",
        "",
        "The actions that each kind of peer may perform on a host, by access path. Generated from",
        "[the table](../../tests/matrix/security.yaml) by `python tests/matrix/page.py --write`.",
        "A test checks every cell on a real host: on its links, at its Unix socket, at its start,",
        "and in its machine.",
        "",
        f"{len(every)} cells, {sum(cell.kept for cell in every)} of them as intended.",
    ]
    for way in ways():
        lines += ["", f"## {way.title}", "", way.text.strip(), ""]
        lines += [f"- **{short}**: {text}" for short, text in way.columns.items()]
        lines += ["", f"| | {' | '.join(way.columns)} |", f"|---{'|---' * len(way.columns)}|"]
        for text, marks in way.rows.values():
            lines.append(f"| {text} | {' | '.join(SHOWN[mark] for mark in marks)} |")
    return "\n".join(lines) + "\n"
