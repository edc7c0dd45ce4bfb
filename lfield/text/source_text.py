"""Source texts, positions in them, and diagnostics rendered with a caret."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

from msgspec import Struct

from lfield.text.terminal_escape import escape_line

#: The most characters of a line in a diagnostic.
MAX_SHOWN = 160


@dataclass(frozen=True, eq=False)
class Source:
    """A text with its displayed name (usually its path)."""

    name: str
    text: str

    @cached_property
    def _starts(self) -> list[int]:
        starts = [0]
        starts.extend(i + 1 for i, ch in enumerate(self.text) if ch == "\n")
        return starts

    def line_column(self, offset: int) -> tuple[int, int]:
        """Line and column of a character offset, both counted from 1."""
        line = bisect_right(self._starts, offset) - 1
        return line + 1, offset - self._starts[line] + 1

    def line_text(self, line: int) -> str:
        """The text of a line (counted from 1) without its newline."""
        return self.text[slice(*self.line_ends(line))]

    def line_ends(self, line: int) -> tuple[int, int]:
        """The start and end of a line (counted from 1), without its newline."""
        start = self._starts[line - 1]
        end = self._starts[line] - 1 if line < len(self._starts) else len(self.text)
        while end > start and self.text[end - 1] == "\r":
            end -= 1
        return start, end


class Span(Struct, frozen=True):
    """Characters `start` to `end` (exclusive) of a source."""

    source: Source
    start: int
    end: int

    @property
    def line(self) -> int:
        """Line of the first character, from 1."""
        return self.source.line_column(self.start)[0]

    @property
    def column(self) -> int:
        """Column of the first character, from 1."""
        return self.source.line_column(self.start)[1]

    @property
    def text(self) -> str:
        """The characters of the span."""
        return self.source.text[self.start : self.end]

    def to(self, other: Span) -> Span:
        """The span from the start of this one to the end of another in the same source."""
        return Span(self.source, self.start, max(self.end, other.end))


class Diagnostic(Struct, frozen=True):
    """One finding: `L203`, a sentence, its position, and the remedy."""

    code: str
    message: str
    span: Span
    hint: str = ""
    severity: str = "error"

    def render(self) -> str:
        """`file:line:col: error[LNNN]: sentence`, the source line, a caret, and the hint."""
        line, column = self.span.source.line_column(self.span.start)
        text, before = _window(self.span.source, line, column - 1)
        # Control characters of terminals are shown as dots, one for one.
        visible_text = "".join(ch if ch.isprintable() or ch == "\t" else "·" for ch in text)
        # The margin keeps tabs so that the caret is under the right character.
        margin = "".join("\t" if ch == "\t" else " " for ch in text[:before])
        width = max(1, min(self.span.end - self.span.start, len(text) - before))
        position = f"{self.span.source.name}:{line}:{column}"
        lines = [
            escape_line(f"{position}: {self.severity}[{self.code}]: {self.message}"),
            f"    {visible_text}",
            f"    {margin}^{'~' * (width - 1)}",
        ]
        if self.hint:
            lines.append(escape_line(f"    hint: {self.hint}"))
        return "\n".join(lines)

    def as_data(self) -> dict[str, object]:
        """The finding for a program: file, range (lines and columns from 1, the end exclusive), and texts."""
        line, column = self.span.source.line_column(self.span.start)
        end_line, end_column = self.span.source.line_column(self.span.end)
        return {
            "file": self.span.source.name,
            "range": {
                "start": {"line": line, "column": column},
                "end": {"line": end_line, "column": end_column},
            },
            "severity": self.severity,
            "code": self.code,
            "message": self.message,
            "hint": self.hint,
        }


#: The meaning of the codes of findings without a position.
FINDING_CODES = {
    "bindings": "a mistake in a devices file, or in a device that it names",
    "bundle-warning": "a warning from the build of the bundle",
    "driver-broken": "an installed driver cannot be used; a missing device type may be one of its types",
    "no-program": "a deployment without its program: types and arguments were not checked",
    "registry-note": "the program lacks portals that the registry of the mission promises for a resource",
}


class PlainFinding(Struct, frozen=True):
    """A finding without a position in a file; `FINDING_CODES` lists its codes."""

    message: str
    severity: str = "error"
    code: str = "bindings"

    def render(self) -> str:
        """The sentence after severity and code, unless it begins with them."""
        is_complete = self.severity == "note" or self.code == "bundle-warning"
        return self.message if is_complete else f"{self.severity}[{self.code}]: {self.message}"

    def as_data(self) -> dict[str, object]:
        """The fields of a `Diagnostic`, without file and range."""
        found = {"severity": self.severity, "code": self.code, "message": self.message, "hint": ""}
        return {"file": None, "range": None, **found}


def _window(source: Source, line: int, place: int) -> tuple[str, int]:
    """The shown part of a line, and the offset of `place` in it; a long line is cut around it."""
    start, end = source.line_ends(line)
    skipped = max(0, min(place - MAX_SHOWN // 2, end - start - MAX_SHOWN))
    return source.text[start + skipped : min(end, start + skipped + MAX_SHOWN)], place - skipped


class Diagnostics(Struct):
    """Collects findings, so that one run reports all of them."""

    found: list[Diagnostic] = []
    _places: set[tuple[str, int, Source]] = set()

    def add(self, diagnostic: Diagnostic) -> None:
        """Add a finding; a second finding with the same code and position is dropped."""
        place = (diagnostic.code, diagnostic.span.start, diagnostic.span.source)
        if place not in self._places:
            self._places.add(place)
            self.found.append(diagnostic)

    @property
    def errors(self) -> list[Diagnostic]:
        """The errors in source order (without warnings)."""
        return [d for d in self.in_order() if d.severity == "error"]

    def in_order(self) -> list[Diagnostic]:
        """All findings, sorted by file, then position."""
        return sorted(self.found, key=lambda d: (d.span.source.name, d.span.start))
