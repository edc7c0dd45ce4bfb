"""The front end as one call: a file or a text in, a checked program or diagnostics out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path

from msgspec import Struct

from lfield.errors import ProgramError
from lfield.lang import syntax
from lfield.lang.capability_port import CapabilityTypes, GeneratedClasses, unknown_names
from lfield.lang.checker import check_program
from lfield.lang.checker.symbols import BUILTIN_TYPES
from lfield.lang.includes import FileSet, FindInclude
from lfield.lang.parser import parse_file
from lfield.lang.tree import CheckedProgram
from lfield.manifest import DeviceManifest
from lfield.text.input_files import MAX_TEXT, read_bytes
from lfield.text.source_text import Diagnostic, Diagnostics, Source


class CheckResult(Struct, frozen=True):
    """The result of the front end: the program (None when there are errors), and all diagnostics in order."""

    program: CheckedProgram | None
    diagnostics: list[Diagnostic]

    @property
    def errors(self) -> list[Diagnostic]:
        """The diagnostics without the warnings."""
        return [d for d in self.diagnostics if d.severity == "error"]

    def or_raise(self) -> CheckedProgram:
        """The program, or ProgramError with the errors."""
        if self.program is None:
            raise ProgramError(self.errors)
        return self.program


def no_include(path: str) -> Path | None:
    """The `find_include` of a program without drivers: `include <...>;` finds nothing."""
    return None


def check_file(
    path: Path,
    *,
    devices: Mapping[str, DeviceManifest] | None = None,
    find_include: FindInclude = no_include,
    capabilities: CapabilityTypes | None = None,
    doubled: Collection[str] = (),
) -> CheckResult:
    """Check a program file and all it includes.

    `devices` are the device types of the drivers by their name; `find_include` maps the path in
    `include <name/file.L>;` to a file; `capabilities` are the types of the registry. Of `doubled` resources
    no code will run: their use of devices of a missing driver is left out. Raises
    InputFileError when the file itself cannot be read; all other mistakes are diagnostics.
    """
    data = read_bytes(path, MAX_TEXT)
    found = Diagnostics()
    files = FileSet(found, find_include)
    files.read(data, path)
    for file in files.files:
        for unit in file.units:
            if unit.name in doubled:
                _keep_only_portals(file, unit, {*BUILTIN_TYPES, *(devices or {})})
    return _checked(files, found, devices or {}, capabilities)


def check_text(
    text: str,
    name: str = "program.L",
    *,
    devices: Mapping[str, DeviceManifest] | None = None,
    find_include: FindInclude = no_include,
    capabilities: CapabilityTypes | None = None,
) -> CheckResult:
    """Check a program text; includes are relative to the folder of `name`."""
    found = Diagnostics()
    files = FileSet(found, find_include)
    files.add(Source(name, text), Path(name))
    return _checked(files, found, devices or {}, capabilities)


def _checked(
    files: FileSet,
    diagnostics: Diagnostics,
    devices: Mapping[str, DeviceManifest],
    capabilities: CapabilityTypes | None,
) -> CheckResult:
    classes = _generated(files, devices, capabilities) if capabilities is not None else GeneratedClasses({})
    if classes.classes and capabilities is not None and not diagnostics.errors:
        for diagnostic in capabilities.registry_problems(classes.classes, files.files):
            diagnostics.add(diagnostic)
        if diagnostics.errors:
            # Every call of a wrong portal would repeat the finding.
            return CheckResult(None, diagnostics.in_order())
    generated = [parse_file(source, diagnostics) for source in (*classes.common, *classes.classes.values())]
    program = check_program(
        [*generated, *files.files],
        devices,
        diagnostics,
        complete=files.complete,
        capabilities=capabilities,
        generated=frozenset(classes.classes),
    )
    return CheckResult(None if diagnostics.errors else program, diagnostics.in_order())


def _keep_only_portals(file: syntax.ParsedFile, unit: syntax.Unit, known: Collection[str]) -> None:
    """Reduce a resource with an unknown device to its portals, which wait without end."""
    names = {field.type.name for field in unit.fields} & unknown_names([file], known)
    if not names:
        return
    unit.fields = []
    unit.methods = [method for method in unit.methods if method.kind in ("init", "portal")]
    for method in unit.methods:
        forever = syntax.Literal_(method.span, 1, value=True)
        method.body = [syntax.While(method.span, forever, syntax.BlockStmt(method.span, []))]
    file.types -= names


def _generated(
    files: FileSet, devices: Mapping[str, DeviceManifest], capabilities: CapabilityTypes
) -> GeneratedClasses:
    """The classes of all capabilities that the files name; the files these bring along are read too."""
    known = {*BUILTIN_TYPES, *devices}
    requested: set[str] = set()
    classes = GeneratedClasses({})
    while unknown := unknown_names(files.files, {*known, *requested}):
        new = unknown.intersection(capabilities.names())
        if not new:
            break
        requested |= new
        classes = capabilities.generate(requested, files.files)
        for path in classes.files:
            files.read(read_bytes(path, MAX_TEXT), path)
    return classes
