"""Every mistake in some files of a registry, also against the resources of a program."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from lfield.capability.model import Registry
from lfield.capability.reading.reader import check_files, shipped
from lfield.capability.reading.signatures import Signature, signatures_of
from lfield.capability.types.live_units import settle_live
from lfield.capability.types.program_check import check_against, check_classes, check_questions, check_types
from lfield.driver.plugins import Plugins, discover
from lfield.errors import ProgramError
from lfield.lang.includes import FileSet
from lfield.lang.syntax import File
from lfield.mission.load import CAPABILITIES, agents_of, beside, compile_file
from lfield.text.files import MAX_TEXT, read_bytes
from lfield.text.source import Diagnostic, Diagnostics


def check_registry(
    files: Sequence[Path], *, alone: bool = False, program: Path | None = None
) -> list[Diagnostic]:
    """What is wrong with some files together with those that come with lfield, unless they stand `alone`.

    A file named `NAME.capabilities.yaml` is a mission's: it may override the others, its agents are those of
    `NAME.dL` beside it, and without a `program` its program is `NAME.L` there. Raises InputFileError for a
    file that cannot be read.
    """
    missions = [path for path in files if path.name.endswith(CAPABILITIES)]
    plugins = discover()
    ours = [] if alone else [*shipped(), *plugins.capabilities]
    known = {path.resolve() for path in ours}
    base = [*ours, *(path for path in files if path not in missions and path.resolve() not in known)]
    found = Diagnostics()
    each: Sequence[Path | None] = missions or [None]
    for mission in each:
        deployment = None if mission is None else _deployment(mission)
        chosen = program or (beside(deployment, ".L") if deployment is not None else None)
        units = None if chosen is None else signatures_of(program_files(chosen, plugins, found))
        agents = None if deployment is None else agents_of(deployment)
        registry, mistakes = check_files(base, mission=mission, agents=agents)
        for mistake in mistakes:
            found.add(mistake)
        if registry is not None:
            _check_calls(registry, units or {}, plugins, found)
        if registry is not None and mission is not None and units is not None:
            own = [name for name, unit in units.items() if unit.kind == "resource"]
            check_types(registry, mission, own, plugins.find_source, found)
        if registry is not None and chosen is not None and _asks(registry):
            # What is wrong with the program itself, `lfield check` says.
            with suppress(ProgramError):
                check_questions(registry, compile_file(chosen)[0], found)
    return _once(found.in_order())


def _once(mistakes: Sequence[Diagnostic]) -> list[Diagnostic]:
    """Each once: what all missions share was read for each of them."""
    return list({(m.code, m.span.source.name, m.span.start): m for m in mistakes}.values())


def program_files(path: Path, plugins: Plugins, found: Diagnostics) -> list[File]:
    """A program and all it includes, parsed. Raises InputFileError."""
    files = FileSet(found, plugins.find_source)
    files.read(read_bytes(path, MAX_TEXT), path)
    return files.files


def _check_calls(
    registry: Registry, signatures: Mapping[str, Signature], plugins: Plugins, found: Diagnostics
) -> None:
    check_classes(registry, found)
    check_against(registry, signatures, found)
    devices = {name: unit.devices for name, unit in signatures.items() if unit.kind == "resource"}
    settle_live(registry, devices, plugins.device_types, found)


def _asks(registry: Registry) -> bool:
    return any(live.portal for provider in registry.providers.values() for live in provider.live.values())


def _deployment(mission: Path) -> Path:
    """The deployment that a mission's file belongs to, whether it is there or not."""
    return mission.with_name(f"{mission.name.removesuffix(CAPABILITIES)}.dL")
