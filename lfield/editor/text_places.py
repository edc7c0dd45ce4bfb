"""Places in files, as counted by editors.

Lines are counted from 0. Columns are UTF-16 code units, or characters if an editor requests them.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from pathlib import Path

from msgspec import Struct


class TextPlace(Struct, frozen=True):
    """Characters `start` to `end` (exclusive) of a file."""

    path: Path
    #: Offsets from the start of the file.
    start: int
    end: int


class TextEdit(Struct, frozen=True):
    """A place, and the text that replaces it."""

    place: TextPlace
    text: str


class LineIndex:
    """The lines of a text; with `is_utf16` columns are UTF-16 code units."""

    def __init__(self, text: str, *, is_utf16: bool) -> None:
        self._text, self._is_utf16 = text, is_utf16 and not text.isascii()
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]

    def position(self, offset: int) -> tuple[int, int]:
        """Line and column of an offset."""
        line = bisect_right(self._starts, offset) - 1
        start = self._starts[line]
        return line, self._units(self._text[start:offset])

    def offset(self, line: int, column: int) -> int:
        """The offset of a line and column; places outside the text are moved into it."""
        if line >= len(self._starts):
            return len(self._text)
        start = self._starts[line]
        end = self._starts[line + 1] - 1 if line + 1 < len(self._starts) else len(self._text)
        if not self._is_utf16:
            return min(start + column, end)
        units = 0
        for at in range(start, end):
            if units >= column:
                return at
            units += self._units(self._text[at])
        return end

    def _units(self, text: str) -> int:
        return len(text) + sum(ord(ch) > 0xFFFF for ch in text) if self._is_utf16 else len(text)
