"""The environment of the language server: files, installed drivers, registries of capabilities."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from lfield.capability.program_types.registry_types import RegistryTypes
from lfield.driver.plugins import discover
from lfield.errors import LfieldError
from lfield.lang.capability_port import (
    CapabilityTypes,
    CompiledQuery,
    ConstraintProblem,
    GeneratedClasses,
    PlaceholderSort,
    QueryPlaceholders,
)
from lfield.lang.includes import FindInclude
from lfield.lang.syntax import ParsedFile
from lfield.manifest import DeviceManifest
from lfield.mission.loader import CAPABILITIES, registry_of_program, sibling_file
from lfield.text.input_files import MAX_TEXT, error_reason, invalid_byte, read_within
from lfield.text.source_text import Diagnostic


class DiskFiles:
    """The files of this computer."""

    def read(self, path: Path) -> str | None:
        """The text of a file, None if it cannot be read."""
        try:
            return _text(path)
        except (OSError, ValueError):
            return None

    def names(self, folder: Path) -> Sequence[str]:
        """The names of the files in a folder."""
        try:
            return sorted(path.name for path in folder.iterdir())
        except OSError:
            return ()


def _text(path: Path) -> str:
    """The text of a file. Raises OSError or ValueError."""
    return read_within(path, MAX_TEXT).decode("utf-8-sig")


class InstalledEnvironment:
    """The drivers that are installed beside lfield."""

    def __init__(self) -> None:
        self._plugins = discover()
        self._devices = self._plugins.device_types
        self._shipped: CapabilityTypes | None = None

    @property
    def devices(self) -> Mapping[str, DeviceManifest]:
        """The device types of all drivers."""
        return self._devices

    @property
    def find_include(self) -> FindInclude:
        """The file of `include <driver/name.L>`."""
        return self._plugins.find_source

    @property
    def include_paths(self) -> list[str]:
        """The files that drivers have for programs."""
        return [
            f"{name}/{source}"
            for name, installed in sorted(self._plugins.by_driver.items())
            for source in installed.plugin.sources()
        ]

    def read_problem(self, path: Path) -> str:
        """The reason why a file cannot be read, '' for none or a missing file."""
        try:
            _text(path)
        except FileNotFoundError:
            return ""
        except UnicodeDecodeError as error:
            where, byte = invalid_byte(str(path), error)
            return f"it is not UTF-8 in line {where.line} (byte {byte})"
        except (OSError, ValueError) as error:
            return error_reason(error)
        return ""

    def capabilities(self, program: Path) -> CapabilityTypes:
        """The registry of a program; without capabilities if it has errors, which `lfield check` reports."""
        try:
            if sibling_file(program, CAPABILITIES) is not None:
                return _ReadableRegistry(registry_of_program(program, self._plugins))
            if self._shipped is None:
                self._shipped = _ReadableRegistry(registry_of_program(program, self._plugins))
            return self._shipped
        except LfieldError:
            return _ReadableRegistry(None)


class _ReadableRegistry:
    """A registry that is empty if it cannot be read."""

    def __init__(self, types: RegistryTypes | None) -> None:
        self._types = types

    def names(self) -> Collection[str]:
        """The capabilities that can be called."""
        try:
            return self._types.names() if self._types is not None else ()
        except LfieldError:
            self._types = None
            return ()

    def generate(self, expected: Collection[str], files: Sequence[ParsedFile]) -> GeneratedClasses:
        """The classes of some capabilities."""
        return GeneratedClasses({}) if self._types is None else self._types.generate(expected, files)

    def registry_problems(self, used: Collection[str], files: Sequence[ParsedFile]) -> Sequence[Diagnostic]:
        """The mistakes of the registry in relation to the program."""
        return () if self._types is None else self._types.registry_problems(used, files)

    def mistakes(self, constraint: str) -> Sequence[ConstraintProblem]:
        """The mistakes in a condition."""
        return () if self._types is None else self._types.mistakes(constraint)

    def placeholders(self, text: str) -> QueryPlaceholders:
        """The placeholders in a condition."""
        return QueryPlaceholders() if self._types is None else self._types.placeholders(text)

    def compile_query(self, text: str, sorts: Mapping[str, PlaceholderSort]) -> CompiledQuery:
        """A condition whose placeholders have values of these sorts."""
        return CompiledQuery() if self._types is None else self._types.compile_query(text, sorts)
