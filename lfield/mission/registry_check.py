"""Every mistake in some files of a registry, also against the resources of a program."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from lfield.capability.model import Registry
from lfield.capability.reading.reader import check_files, shipped
from lfield.capability.reading.signatures import Signature, signatures_of
from lfield.capability.types.live_units import settle_live
from lfield.capability.types.program_check import (
    check_against,
    check_classes,
    check_questions,
    check_types,
    fulfilled,
)
from lfield.driver.plugins import Plugins, discover
from lfield.errors import Finding, ProgramError
from lfield.lang.includes import FileSet
from lfield.lang.syntax import File
from lfield.mission.load import CAPABILITIES, agents_of, beside, compile_file
from lfield.text.files import MAX_TEXT, read_bytes
from lfield.text.source import Diagnostic, Diagnostics, Remark, Span
from lfield.text.suggest import listed


def check_registry(
    files: Sequence[Path], *, alone: bool = False, program: Path | None = None
) -> list[Finding]:
    """What is wrong with some files together with those that come with lfield, unless they stand `alone`.

    A file named `NAME.capabilities.yaml` is a mission's: it may override the others, its agents are those of
    `NAME.dL` beside it, and without a `program` its program is `NAME.L` there. A note says of a resource of
    the program that only has the name of ours what it does not serve. Raises InputFileError for a file that
    cannot be read.
    """
    missions = [path for path in files if path.name.endswith(CAPABILITIES)]
    plugins = discover()
    ours = [] if alone else [*shipped(), *plugins.capabilities]
    known = {path.resolve() for path in ours}
    base = [*ours, *(path for path in files if path not in missions and path.resolve() not in known)]
    found, unserved = Diagnostics(), dict[str, Remark]()
    each: Sequence[Path | None] = missions or [None]
    for mission in each:
        deployment = None if mission is None else _deployment(mission)
        chosen = program or (beside(deployment, ".L") if deployment is not None else None)
        units = {} if chosen is None else signatures_of(program_files(chosen, plugins, found))
        agents = None if deployment is None else agents_of(deployment)
        registry, mistakes = check_files(base, mission=mission, agents=agents)
        for mistake in mistakes:
            found.add(mistake)
        if registry is None:
            continue
        check_classes(registry, found)
        for mistake in _misfits(registry, mission, chosen, units, plugins):
            if not _of(mistake.span, ours) or _of(mistake.span, files):
                found.add(mistake)
        unserved |= {note.message: note for note in _unserved(registry, units, ours)}
    return [*_once(found.in_order()), *unserved.values()]


def _of(span: Span, files: Iterable[Path]) -> bool:
    """Whether something stands in one of some files."""
    return Path(span.source.name).resolve() in {file.resolve() for file in files}


def _once(mistakes: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Each once: what all missions share was read for each of them."""
    return list({(m.code, m.span.source.name, m.span.start): m for m in mistakes}.values())


def _misfits(
    registry: Registry,
    mission: Path | None,
    program: Path | None,
    units: Mapping[str, Signature],
    plugins: Plugins,
) -> list[Diagnostic]:
    """What a registry says wrongly of the resources of a program."""
    found = Diagnostics()
    check_against(registry, units, found)
    resources = {name: unit for name, unit in units.items() if unit.kind == "resource"}
    devices = {name: unit.devices for name, unit in resources.items()}
    settle_live(registry, devices, plugins.device_types, found)
    if mission is not None and program is not None:
        check_types(registry, mission, resources, plugins.find_source, found)
    if program is not None and _asks(registry):
        # What is wrong with the program itself, `lfield check` says.
        with suppress(ProgramError):
            check_questions(registry, compile_file(program)[0], found)
    return found.in_order()


def _unserved(registry: Registry, units: Mapping[str, Signature], ours: Sequence[Path]) -> Iterator[Remark]:
    """What files of ours promise of resource types that in a program are others, a line for each type."""
    for type, provider in fulfilled(registry, units).providers.items():
        promised = registry.providers[type].serves
        lost = [name for name in promised if name not in provider.serves and _of(promised[name].span, ours)]
        if lost:
            said = (
                f"the {type} of the program does not serve {listed(lost)}, as ours does: it lacks the portals"
            )
            yield Remark(f"note: {said}", "note")


def program_files(path: Path, plugins: Plugins, found: Diagnostics) -> list[File]:
    """A program and all it includes, parsed. Raises InputFileError."""
    files = FileSet(found, plugins.find_source)
    files.read(read_bytes(path, MAX_TEXT), path)
    return files.files


def _asks(registry: Registry) -> bool:
    return any(live.portal for provider in registry.providers.values() for live in provider.live.values())


def _deployment(mission: Path) -> Path:
    """The deployment that a mission's file belongs to, whether it is there or not."""
    return mission.with_name(f"{mission.name.removesuffix(CAPABILITIES)}.dL")
