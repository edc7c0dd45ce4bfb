"""A program with all its files, checked in steps, as shown by an editor.

An edit parses one unit again and reads all declarations. The bodies of other units are checked again only if
a declaration has changed; `step` checks one part, so that a request never waits for the whole program.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Protocol

from msgspec import Struct
from msgspec.structs import replace

from lfield.editor.program_parts import PartPlace, ProgramFile, ProgramPart, parse_part
from lfield.lang import messages, tree
from lfield.lang.capability_port import CapabilityTypes, unknown_names
from lfield.lang.checker import check_program
from lfield.lang.checker.declaration_pass import DeclaredUnit
from lfield.lang.checker.program_checker import check_bodies, check_function
from lfield.lang.checker.symbols import BUILTIN_TYPES, Function, Symbols
from lfield.lang.checker.top_level.declared_program import declare_program
from lfield.lang.includes import FindInclude
from lfield.lang.syntax import Include, ParsedFile
from lfield.lang.tree import CheckedProgram
from lfield.manifest import DeviceManifest
from lfield.text.source_text import Diagnostic, Diagnostics

ReadText = Callable[[Path], str | None]


class ProgramEnvironment(Protocol):
    """The environment of a program besides its own files."""

    @property
    def devices(self) -> Mapping[str, DeviceManifest]:
        """The device types of the installed drivers."""

    @property
    def find_include(self) -> FindInclude:
        """The file of `include <path>`."""

    @property
    def include_paths(self) -> list[str]:
        """The paths of files for `include <path>`."""

    def read_problem(self, path: Path) -> str:
        """The reason why a file cannot be read, '' if there is none."""

    def capabilities(self, program: Path) -> CapabilityTypes:
        """The registry of a program."""


class _Generated(Struct):
    """The classes of capabilities for some declarations of the program."""

    key: object
    parts: list[ProgramPart]
    names: frozenset[str]
    problems: list[Diagnostic]


class ProgramModel:
    """The program whose first file is `root`."""

    def __init__(self, root: Path, read: ReadText, environment: ProgramEnvironment) -> None:
        self.root, self._read, self.environment = root, read, environment
        self.files: dict[Path, ProgramFile] = {}
        self.capabilities = environment.capabilities(root)
        self._include_findings: list[Diagnostic] = []
        self._generated = _Generated(None, [], frozenset(), [])
        self._declared: list[tuple[ProgramPart, DeclaredUnit]] = []
        self._functions: list[tuple[ProgramPart, Function]] = []
        self._declarations: object = None
        #: Whether a file could not be read.
        self._is_missing = False
        #: Counts the changes of the declarations.
        self._version = 0
        self._program: CheckedProgram | None = None
        self.symbols = self._new_symbols(is_incomplete=True)

    def update(self) -> None:
        """Read and parse the files that have changed, and all declarations."""
        is_changed, is_incomplete = self._read_files()
        if not is_changed and self._declarations is not None:
            return
        self._declare(is_incomplete=is_incomplete)
        if self._generate():
            self._declare(is_incomplete=is_incomplete)

    # --- files ------------------------------------------------------------------------------------------

    def _read_files(self) -> tuple[bool, bool]:
        """Read the files; returns whether a file has changed, and whether one is missing."""
        files: dict[Path, ProgramFile] = {}
        self._include_findings, is_missing, is_changed = [], False, False
        waiting: list[tuple[Path, Include | None]] = [(self.root, None)]
        while waiting:
            path, include = waiting.pop(0)
            if path in files:
                continue
            text = self._read(path)
            if text is None:
                is_missing = True
                if include is not None:
                    self._include_findings.append(self._unread(include, path))
                continue
            files[path] = file = self.files.get(path) or ProgramFile(str(path))
            is_changed |= file.update(text)
            for part in file.parts:
                for include in part.file.includes:
                    if (target := self.included(include, path)) is not None:
                        waiting.append((target, include))
                    else:
                        is_missing = True
                        self._include_findings.append(
                            messages.INCLUDE_UNKNOWN.at(include.span, path=include.path)
                        )
        is_changed |= files.keys() != self.files.keys()
        self.files, self._is_missing = files, is_missing
        return is_changed, is_missing or any(part.file.broken for part in self.parts())

    def _unread(self, include: Include, path: Path) -> Diagnostic:
        if reason := self.environment.read_problem(path):
            return messages.INCLUDE_UNREADABLE.at(include.span, path=f"'{path}'", reason=reason)
        return messages.INCLUDE_MISSING.at(include.span, path=path)

    def included(self, include: Include, origin: Path) -> Path | None:
        """The file of an include; None for one that no driver has."""
        if include.library:
            return self.environment.find_include(include.path)
        return (
            (origin.parent / include.path).resolve() if ".." in include.path else origin.parent / include.path
        )

    def parts(self) -> Iterator[ProgramPart]:
        """The parts of all files."""
        for file in self.files.values():
            yield from file.parts

    def path_of(self, source_name: str) -> Path | None:
        """The file of a source."""
        return next((path for path, file in self.files.items() if file.name == source_name), None)

    # --- declarations -----------------------------------------------------------------------------------

    def _new_symbols(self, *, is_incomplete: bool) -> Symbols:
        return Symbols(
            self.environment.devices,
            Diagnostics(),
            incomplete=is_incomplete,
            missing=self._is_missing,
            capabilities=self.capabilities,
            generated=self._generated.names,
        )

    def _declare(self, *, is_incomplete: bool) -> None:
        """Read all declarations of the present parts."""
        self.dismantle()
        self.symbols = self._new_symbols(is_incomplete=is_incomplete)
        parts = [*self._generated.parts, *self.parts()]
        owners = {part.source: part for part in parts}
        program = declare_program(self.symbols, [part.file for part in parts])
        # The span of a parsed unit has a source.
        self._declared = [(owners[unit.unit.span.source], unit) for unit in program.units]  # type: ignore[index]
        self._functions = [(owners[function.head.span.source], function) for function in program.functions]  # type: ignore[index]
        declarations = (
            is_incomplete,
            self._generated.names,
            tuple(_fingerprint(unit.unit) for unit in program.units),
            _top_level(self.symbols),
            frozenset(self.symbols.broken_units),
        )
        if declarations != self._declarations:
            self._declarations, self._version = declarations, self._version + 1

    def dismantle(self) -> None:
        """Free the declarations at once, since the server does not collect garbage among them."""
        complete = self._program.units if self._program is not None else ()
        for unit in (*self.symbols.units.values(), *complete):
            unit.dismantle()
        for _, function in self._functions:
            function.head.body.clear()
        self._program = None

    def _generate(self) -> bool:
        """Create the classes of the capabilities that the program names; returns whether they have
        changed.
        """
        files: list[ParsedFile] = [part.file for part in self.parts()]
        known = {*BUILTIN_TYPES, *self.environment.devices}
        unknown = unknown_names(files, known)
        requested = frozenset(unknown.intersection(self.capabilities.names()) if unknown else ())
        units = tuple(_fingerprint(unit.unit) for part, unit in self._declared if not unit.unit.capability)
        key = (requested, units if requested else ())
        if key == self._generated.key:
            return False
        before = self._generated.names
        self._generated = (
            self._capability_classes(requested, files, key)
            if requested
            else _Generated(key, [], frozenset(), [])
        )
        return bool(before or requested)

    def _capability_classes(
        self, requested: frozenset[str], files: list[ParsedFile], key: object
    ) -> _Generated:
        """The classes of some capabilities, and the files that they need besides."""
        classes = self.capabilities.generate(requested, files)
        parts = [
            parse_part(source.name, source.text, PartPlace())
            for source in (*classes.common, *classes.classes.values())
        ]
        for path in classes.files:
            if path not in self.files and (text := self._read(path)) is not None:
                file = ProgramFile(str(path))
                file.update(text)
                parts += file.parts
        problems = list(self.capabilities.registry_problems(classes.classes, files))
        return _Generated(key, parts, frozenset(classes.classes), problems)

    # --- findings ---------------------------------------------------------------------------------------

    def step(self, first: Path | None = None) -> bool:
        """Check one part whose findings are out of date; False if there is none.

        An edited part comes first, then the others of the file `first`.
        """
        stale = [part for part in self.parts() if part.checked_for != self._version]
        if not stale:
            return False
        name = str(first)
        self._check(min(stale, key=lambda part: (part.checked_for > 0, part.source.name != name)))
        return True

    def _check(self, part: ProgramPart) -> None:
        found = Diagnostics()
        symbols = replace(self.symbols, found=found, _reported=set())
        for owner, declared in self._declared:
            if owner is part:
                check_bodies(symbols, declared)
        for owner, function in self._functions:
            if owner is part:
                check_function(symbols, function)
        part.store(found.found, self._version)

    def findings(self) -> list[Diagnostic]:
        """All findings so far, sorted by file and position."""
        bodies = (finding for part in self.parts() for finding in part.findings)
        syntax = (finding for part in self.parts() for finding in part.syntax_findings)
        found = [*syntax, *self.symbols.found.found, *self._include_findings]
        if self._generated.problems and not any(finding.severity == "error" for finding in found):
            found += self._generated.problems
        else:
            found += bodies
        places = {(f.code, f.span.start, f.span.source): f for f in reversed(found)}
        ordered = reversed(places.values())
        return sorted(ordered, key=lambda f: (f.span.source.name, f.span.line, f.span.start))

    def complete_program(self) -> CheckedProgram | None:
        """The program with all its bodies, for a check of its deployment; None if it has errors."""
        while self.step():
            pass
        if any(finding.severity == "error" for finding in self.findings()):
            return None
        if self._program is None:
            self._program = check_program(
                [part.file for part in (*self._generated.parts, *self.parts())],
                self.environment.devices,
                Diagnostics(),
                complete=True,
                capabilities=self.capabilities,
                generated=self._generated.names,
            )
        return self._program


def _fingerprint(unit: tree.Unit) -> tuple[object, ...]:
    """The part of a unit that other units depend on."""
    fields = tuple((field.name, field.type, field.public) for field in unit.fields)
    methods = tuple(
        (method.kind, method.signature, method.result, method.public, method.synchronized)
        for method in unit.methods
    )
    return unit.name, unit.kind, unit.usage, unit.capability, fields, methods


def _top_level(symbols: Symbols) -> tuple[object, ...]:
    """The parts of constants, enums and functions that units depend on."""
    constants = tuple(
        (constant.name, constant.type, constant.value) for constant in symbols.constants.values()
    )
    enums = tuple((enum.name, enum.members) for enum in symbols.enums.values())
    heads = [function.head for functions in symbols.functions.values() for function in functions]
    return constants, enums, tuple((head.signature, head.result) for head in heads)
