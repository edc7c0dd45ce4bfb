"""Files of a program: the one given and all it includes, each once."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from lfield.lang import messages
from lfield.lang.parser import parse_file
from lfield.lang.syntax import Include, ParsedFile
from lfield.text.input_files import MAX_TEXT, error_reason, invalid_byte, read_within
from lfield.text.source_text import Diagnostic, Diagnostics, Source

FindInclude = Callable[[str], Path | None]


class FileSet:
    """Reads and parses files; `complete` is False when an include could not be read."""

    def __init__(self, found: Diagnostics, find_include: FindInclude) -> None:
        self.files: list[ParsedFile] = []
        self.complete = True
        self._found, self._find_include = found, find_include
        self._read_paths: set[str] = set()

    def read(self, data: bytes, path: Path) -> None:
        """Parse the bytes of a file and the files it includes, unless that was done already."""
        if os.path.realpath(path) in self._read_paths:
            return
        source = self._decoded(data, str(path))
        if source is not None:
            self.add(source, path)

    def add(self, source: Source, path: Path) -> None:
        """Parse a source that was read from `path`, then the files it includes, and so on."""
        self._read_paths.add(os.path.realpath(path))
        waiting = [(source, path)]
        while waiting:
            source, path = waiting.pop(0)
            file = parse_file(source, self._found)
            self.files.append(file)
            for include in file.includes:
                waiting.extend(self._included(include, path))

    def _included(self, include: Include, origin: Path) -> list[tuple[Source, Path]]:
        """The source of an include; None when it was already read or cannot be read."""
        path = self._find_include(include.path) if include.library else origin.parent / include.path
        if path is None:
            self._missing(messages.INCLUDE_UNKNOWN.at(include.span, path=include.path))
            return []
        try:
            identity = os.path.realpath(path)
            if identity in self._read_paths:
                return []
            self._read_paths.add(identity)
            source = self._decoded(read_within(path, MAX_TEXT), str(path))
        except FileNotFoundError:
            self._missing(messages.INCLUDE_MISSING.at(include.span, path=path))
            return []
        except (OSError, ValueError) as error:
            quoted = f"'{path}'"
            self._missing(
                messages.INCLUDE_UNREADABLE.at(include.span, path=quoted, reason=error_reason(error))
            )
            return []
        return [] if source is None else [(source, path)]

    def _decoded(self, data: bytes, name: str) -> Source | None:
        """The text of a program file; None (reported) when it is not UTF-8."""
        try:
            return Source(name, data.decode("utf-8-sig"))
        except UnicodeDecodeError as error:
            where, byte = invalid_byte(name, error)
            self._missing(messages.NOT_UTF8.at(where, byte=byte))
            return None

    def _missing(self, diagnostic: Diagnostic) -> None:
        self.complete = False
        self._found.add(diagnostic)
