"""The statements of a program: the instructions at which they begin, and their lines."""

from __future__ import annotations

from bisect import bisect_right
from functools import cached_property
from typing import NamedTuple

from lfield.bytecode.program import LIBRARY_SOURCE, Program


class SourceLine(NamedTuple):
    """A line of a source file, from 1."""

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


class StatementTable:
    """Instructions are identified by their position in the code of `program`.

    The library that is written in L has no statements: it is not code of the author of a program.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        lines: dict[int, SourceLine] = {}
        library = set()
        for number, (method, info) in enumerate(
            zip(program.core.methods, program.debug.methods, strict=False)
        ):
            file = program.debug.sources[info.source].name
            if file == LIBRARY_SOURCE:
                library.add(number)
                continue
            # The first instruction only enters the method; a portal starts after it.
            starts = [(max(pc, method.entry + 1), line) for pc, line in info.lines]
            lines.update((pc, SourceLine(file, line)) for pc, line in starts if pc < method.end)
        #: The methods of the library, by index.
        self.library = frozenset(library)
        #: The line of each statement, by its first instruction.
        self.lines = lines
        #: The first instructions of all statements.
        self.starts = frozenset(lines)
        self._order = sorted(lines)
        self._entries = sorted((method.entry, number) for number, method in enumerate(program.core.methods))

    def method_of(self, pc: int) -> int:
        """The method, by index, that an instruction belongs to."""
        return self._entries[bisect_right(self._entries, (pc, len(self._entries))) - 1][1]

    def line_of(self, pc: int) -> SourceLine | None:
        """The line of the statement that an instruction belongs to; None without debug information."""
        at = bisect_right(self._order, pc) - 1
        if at < 0 or self._order[at] < self.program.core.methods[self.method_of(pc)].entry:
            return None
        return self.lines[self._order[at]]

    def at_line(self, file: str, line: int) -> frozenset[int]:
        """The statements that begin on a line. `file` may lack leading folders."""
        return frozenset(
            pc for pc, at in self.lines.items() if at.line == line and is_same_file(at.file, file)
        )

    def next_line(self, file: str, line: int) -> int | None:
        """The first line from `line` on at which a statement of a file begins."""
        lines = (at.line for at in self.lines.values() if at.line >= line and is_same_file(at.file, file))
        return min(lines, default=None)

    @cached_property
    def variables(self) -> frozenset[str]:
        """The names of all variables and fields."""
        program = self.program
        slots = (name for info in program.debug.methods for _, name in info.names)
        fields = (
            field.name for record in program.core.classes for field in record.fields if not field.is_hidden
        )
        return frozenset([*slots, *fields, "this"])

    @cached_property
    def portals(self) -> frozenset[int]:
        """The first statements of all portals."""
        found = set()
        for method in self.program.core.methods:
            if method.kind == "portal":
                at = bisect_right(self._order, method.entry)
                if at < len(self._order) and self._order[at] < method.end:
                    found.add(self._order[at])
        return frozenset(found)

    def source(self, file: str) -> str | None:
        """The text of a source file; `file` may lack leading folders."""
        sources = self.program.debug.sources
        return next((each.text for each in sources if is_same_file(each.name, file)), None)


def is_same_file(known: str, file: str) -> bool:
    """Whether a file name is that of a known source, or the end of it, or the reverse."""
    if known == file:
        return True
    longer, shorter = (known, file) if len(known) > len(file) else (file, known)
    return longer.endswith(f"/{shorter}")
