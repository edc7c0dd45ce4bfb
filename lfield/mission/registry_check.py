"""`capabilities check`: findings in registry files, also against the resource types of a program."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from lfield.capability.model import Registry
from lfield.capability.program_types.live_units import convert_live_units
from lfield.capability.program_types.program_check import (
    check_against,
    check_classes,
    check_feed_portals,
    check_types,
    satisfied,
)
from lfield.capability.registry_reader.registry_files import check_files, shipped
from lfield.capability.registry_reader.unit_signatures import Signature, signatures_of
from lfield.driver.plugins import Plugins, discover
from lfield.errors import ProgramError, ReportableFinding
from lfield.lang.includes import FileSet
from lfield.lang.syntax import ParsedFile
from lfield.mission.loader import CAPABILITIES, agents_of, compile_file, sibling_file
from lfield.text.input_files import MAX_TEXT, read_bytes
from lfield.text.source_text import Diagnostic, Diagnostics, PlainFinding, Span
from lfield.text.suggestions import listed


def check_registry(
    files: Sequence[Path], *, alone: bool = False, program: Path | None = None
) -> list[ReportableFinding]:
    """The findings in some files, which are merged with the registry of lfield unless `alone`.

    A file named `NAME.capabilities.yaml` belongs to a mission: it may override the registry of lfield, its
    agents are those of `NAME.dL` in its folder, and its program is `NAME.L` unless `program` is given. A note
    lists the primitives that a resource type of the program lacks, with the name of one of lfield. Raises
    InputFileError for a file that cannot be read.
    """
    missions = [path for path in files if path.name.endswith(CAPABILITIES)]
    plugins = discover()
    installed = [] if alone else [*shipped(), *plugins.capabilities]
    installed_paths = {path.resolve() for path in installed}
    base = [
        *installed,
        *(path for path in files if path not in missions and path.resolve() not in installed_paths),
    ]
    diagnostics, unserved = Diagnostics(), dict[str, PlainFinding]()
    each: Sequence[Path | None] = missions or [None]
    for mission in each:
        deployment = None if mission is None else _deployment(mission)
        chosen = program or (sibling_file(deployment, ".L") if deployment is not None else None)
        units = {} if chosen is None else signatures_of(program_files(chosen, plugins, diagnostics))
        agents = None if deployment is None else agents_of(deployment)
        registry, mistakes = check_files(base, mission=mission, agents=agents)
        for mistake in mistakes:
            diagnostics.add(mistake)
        if registry is None:
            continue
        check_classes(registry, diagnostics)
        for mistake in _misfits(registry, mission, chosen, units, plugins):
            if not _is_in(mistake.span, installed) or _is_in(mistake.span, files):
                diagnostics.add(mistake)
        unserved |= {note.message: note for note in _unserved(registry, units, installed)}
    return [*_without_duplicates(diagnostics.in_order()), *unserved.values()]


def _is_in(span: Span, files: Iterable[Path]) -> bool:
    """Whether a name is defined in one of some files."""
    return Path(span.source.name).resolve() in {file.resolve() for file in files}


def _without_duplicates(mistakes: Sequence[Diagnostic]) -> list[Diagnostic]:
    """The findings without duplicates: files that missions share are read once for each of them."""
    return list({(m.code, m.span.source.name, m.span.start): m for m in mistakes}.values())


def _misfits(
    registry: Registry,
    mission: Path | None,
    program: Path | None,
    units: Mapping[str, Signature],
    plugins: Plugins,
) -> list[Diagnostic]:
    """The mismatches between a registry and the resource types of a program."""
    diagnostics = Diagnostics()
    check_against(registry, units, diagnostics)
    resources = {name: unit for name, unit in units.items() if unit.kind == "resource"}
    devices = {name: unit.devices for name, unit in resources.items()}
    convert_live_units(registry, devices, plugins.device_types, diagnostics)
    if mission is not None and program is not None:
        check_types(registry, mission, resources, plugins.find_source, diagnostics)
    if program is not None and _has_queries(registry):
        # `lfield check` reports the errors of the program itself.
        with suppress(ProgramError):
            check_feed_portals(registry, compile_file(program)[0], diagnostics)
    return diagnostics.in_order()


def _unserved(
    registry: Registry, units: Mapping[str, Signature], installed: Sequence[Path]
) -> Iterator[PlainFinding]:
    """Primitives that the registry of lfield promises of a type and the program's type lacks: a line each."""
    for type, provider in satisfied(registry, units).providers.items():
        promised = registry.providers[type].serves
        unserved_names = [
            name
            for name in promised
            if name not in provider.serves and _is_in(promised[name].span, installed)
        ]
        if unserved_names:
            message = (
                f"resource {type} of the program does not serve {listed(unserved_names)}, unlike the one in "
                "lfield: it lacks the portals"
            )
            yield PlainFinding(f"note: {message}", "note", "registry-note")


def program_files(path: Path, plugins: Plugins, found: Diagnostics) -> list[ParsedFile]:
    """A program and all files that it includes, parsed. Raises InputFileError."""
    files = FileSet(found, plugins.find_source)
    files.read(read_bytes(path, MAX_TEXT), path)
    return files.files


def _has_queries(registry: Registry) -> bool:
    return any(live.portal for provider in registry.providers.values() for live in provider.live.values())


def _deployment(mission: Path) -> Path:
    """The path of the deployment that belongs to a mission's file; it may not exist."""
    return mission.with_name(f"{mission.name.removesuffix(CAPABILITIES)}.dL")
