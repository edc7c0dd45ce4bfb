"""A program text in parts: each unit is parsed by itself, so that an edit costs the parsing of one unit.

The positions in a part count from its start. Its `PartPlace` is its place in the file, and moves when
text before it is edited.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from msgspec import Struct

from lfield.lang.parser import parse_file
from lfield.lang.scanner import Token, scan
from lfield.lang.syntax import ParsedFile
from lfield.text.source_text import Diagnostic, Diagnostics, Source, Span

#: The start of a unit, a constant or an enum at a line, and text that may hide such a line.
_BOUNDARY = re.compile(
    r"//[^\n]*|/\*(?s:.*?)(?:\*/|\Z)|\"(?:[^\"\\\n]|\\.)*\"?"
    r"|^(?=(?:resource|coordinator|class)\b|const\s+\w+\s+\w+\s*=|enum\s+\w+\s*\{)",
    re.MULTILINE,
)


class PartPlace(Struct, eq=False):
    """The place of a part in its file: the offset of its first character, and the lines before it."""

    offset: int = 0
    line: int = 0

    def move(self, offset: int, line: int) -> bool:
        """Move the part; returns whether its lines have other numbers now."""
        is_moved = line != self.line
        self.offset, self.line = offset, line
        return is_moved


@dataclass(frozen=True, eq=False)
class PartSource(Source):
    """The text of a part; lines are counted in the whole file, offsets in the part."""

    place: PartPlace

    def line_column(self, offset: int) -> tuple[int, int]:
        """Line and column of an offset in the part."""
        line, column = super().line_column(offset)
        return line + self.place.line, column

    def line_ends(self, line: int) -> tuple[int, int]:
        """Start and end of a line of the file, in the part."""
        return super().line_ends(line - self.place.line)


def file_offsets(span: Span) -> tuple[int, int]:
    """Start and end of a span in its file."""
    offset = span.source.place.offset if isinstance(span.source, PartSource) else 0
    return span.start + offset, span.end + offset


@dataclass(eq=False)
class ProgramPart:
    """A parsed part. `findings` are those of its bodies, for a version of the declarations; 0: none."""

    source: PartSource
    file: ParsedFile
    syntax_findings: list[Diagnostic]
    findings: list[Diagnostic] = field(default_factory=list)
    checked_for: int = 0

    @cached_property
    def tokens(self) -> Sequence[Token]:
        """The tokens, END last."""
        return scan(self.source, Diagnostics()).tokens

    @property
    def end(self) -> int:
        """The offset in the file after its last character."""
        return self.source.place.offset + len(self.source.text)

    def store(self, findings: list[Diagnostic], checked_for: int) -> None:
        """Store the findings of the bodies."""
        self.findings, self.checked_for = findings, checked_for


def parse_part(name: str, text: str, place: PartPlace) -> ProgramPart:
    """A part of the file `name`."""
    found, source = Diagnostics(), PartSource(name, text, place)
    return ProgramPart(source, parse_file(source, found), found.found)


class ProgramFile:
    """One file of a program, as its parts."""

    def __init__(self, name: str) -> None:
        self.name, self.text = name, ""
        self.parts: list[ProgramPart] = []

    def update(self, text: str) -> bool:
        """Parse the changed parts; returns whether any part has changed."""
        if text == self.text and self.parts:
            return False
        known: dict[str, list[ProgramPart]] = {}
        for old in reversed(self.parts):
            known.setdefault(old.source.text, []).append(old)
        self.parts, self.text, line = [], text, 0
        for start, end in _boundaries(text):
            piece = text[start:end]
            reusable = known.get(piece)
            part = reusable.pop() if reusable else None
            self.parts.append(self._placed(part, piece, start, line))
            line += piece.count("\n")
        return True

    def _placed(self, part: ProgramPart | None, text: str, start: int, line: int) -> ProgramPart:
        """The part of a text that was parsed already, or a new one."""
        if part is not None:
            is_moved = part.source.place.move(start, line)
            # The messages of its findings may contain line numbers.
            if not (is_moved and (part.syntax_findings or part.findings)):
                return part
        return parse_part(self.name, text, PartPlace(start, line))

    def part_at(self, offset: int) -> ProgramPart:
        """The part with a character of the file; the last one for its end."""
        return next((part for part in self.parts if offset < part.end), self.parts[-1])


def _boundaries(text: str) -> Iterator[tuple[int, int]]:
    start = 0
    for match in _BOUNDARY.finditer(text):
        if not match.group() and match.start() > start:
            yield start, match.start()
            start = match.start()
    yield start, len(text)
