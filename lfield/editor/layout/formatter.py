"""The formatted text of a program and of a deployment: `lfield fmt`.

The tokens and comments stay, with the line breaks within statements. So the formatted program is compiled to
the same code. The layout does not depend on its own changes, so a second formatting has no effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec.structs import replace

from lfield.editor.layout.comment_columns import comment_columns
from lfield.editor.layout.line_breaking import further_breaks
from lfield.editor.layout.line_layout import LineLayout, Row
from lfield.editor.layout.source_items import SourceItem, same_content, source_items
from lfield.errors import LfieldError, ProgramError
from lfield.lang.deployment_line import DeploymentEntry, read_line
from lfield.lang.parser import parse_file
from lfield.text.source_text import Diagnostics, Source, Span


def format_program(source: Source) -> str:
    """The text of a program in the layout of `lfield fmt`. Raises ProgramError for syntax errors."""
    found = Diagnostics()
    parse_file(source, found)
    if found.errors:
        raise ProgramError(found.errors)
    items = source_items(source)
    formatted = "".join(f"{line}\n" for line in _lines(_rows(items)))
    if not same_content(items, source_items(Source(source.name, formatted))):
        raise LfieldError(f"bug in lfield: {source.name} not formatted: its tokens would change")
    return formatted


def _rows(items: Sequence[SourceItem]) -> list[Row]:
    """The lines; those that are too long are broken as often as needed."""
    rows = LineLayout(items).rows
    while further := {n for n in further_breaks(rows) if items[n].breaks == 0}:
        items = [replace(item, breaks=1) if n in further else item for n, item in enumerate(items)]
        rows = LineLayout(items).rows
    return rows


def _lines(rows: Sequence[Row]) -> Iterator[str]:
    """The lines as text."""
    columns = comment_columns(rows)
    for number, row in enumerate(rows):
        if row.is_behind_blank:
            yield ""
        comment = row.pieces[-1].item.text
        if number not in columns:
            yield row.text()
        elif row.trailing is None:
            yield " " * columns[number] + comment
        else:
            yield row.text() + " " * (columns[number] - row.width()) + comment


def format_deployment(source: Source) -> str:
    """The text of a deployment without indentation, and with at most one blank line between entries.

    Raises ProgramError for malformed lines.
    """
    found = Diagnostics()
    before = _entries(source, found)
    if found.errors:
        raise ProgramError(found.errors)
    lines: list[str] = []
    for line in source.text.split("\n"):
        text = line.strip()
        if text or (lines and lines[-1]):
            lines.append(text)
    while lines and not lines[-1]:
        lines.pop()
    formatted = "".join(f"{line}\n" for line in lines)
    if before != _entries(Source(source.name, formatted), Diagnostics()):
        raise LfieldError(f"bug in lfield: {source.name} not formatted: its entries would change")
    return formatted


def _entries(source: Source, found: Diagnostics) -> list[tuple[object, ...]]:
    """The contents of the lines, without their positions."""
    entries = (read_line(line, found) for line in source_lines(source))
    return [_content(entry) for entry in entries if entry is not None]


def source_lines(source: Source) -> list[Span]:
    """The lines of a source, without their ends."""
    found, start = [], 0
    for line in source.text.split("\n"):
        found.append(Span(source, start, start + len(line)))
        start += len(line) + 1
    return found


def _content(entry: DeploymentEntry) -> tuple[object, ...]:
    place = entry.type.text, entry.id.text, entry.host.text, entry.port
    return *place, entry.arguments, entry.startable.text
