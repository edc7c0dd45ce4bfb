"""Loads a mission from files on the ground computer: the only part of the runtime that needs the compiler."""

from __future__ import annotations

import gc
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lfield.bytecode.encoding import MAX_SIZE, decode
from lfield.bytecode.program import Program, UnitKind
from lfield.capability.model import Registry
from lfield.capability.program_types.program_resources import check_mission_registry, restrict_to_program
from lfield.capability.program_types.registry_types import RegistryTypes
from lfield.driver.driver_index import DriverIndex
from lfield.driver.plugins import Plugins, discover
from lfield.errors import (
    BindingError,
    DamagedFileError,
    InputFileError,
    ProgramError,
    ProgramFileError,
    ReportableFinding,
)
from lfield.lang.deployment import read_deployment, read_with_warnings
from lfield.mission import bundle
from lfield.mission.access.access_file import read_access
from lfield.mission.access.access_rules import NO_RULES, Access
from lfield.mission.bindings import Bindings, chosen_fakes, without_doubles
from lfield.mission.bindings_file import read_bindings, unstated_options
from lfield.mission.checks.recovery_findings import check_recovery, quorum_warnings
from lfield.mission.mission import Mission, drivers_for, duplicate_statements, needed_devices
from lfield.mission.team import Team, parse_maps, team_of
from lfield.text.input_files import error_reason, read_head, require_file
from lfield.text.source_text import Diagnostic, PlainFinding
from lfield.text.terminal_escape import printable_argument
from lfield.vm.offer_objects import realisations

if TYPE_CHECKING:
    from lfield.lang.frontend import CheckResult
    from lfield.mission.checks.file_literals import FileLiteral

#: Suffixes of the files of a mission, in the folder of its deployment.
DEVICES, CAPABILITIES, ACCESS = ".devices.yaml", ".capabilities.yaml", ".access.yaml"


@contextmanager
def _without_gc() -> Iterator[None]:
    """Disable Python's garbage collector: trees, tables and registries live until the end anyway.

    Each collection would scan all objects, and their number grows with the program.
    """
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


@_without_gc()
def load_mission(
    deploy: Path,
    program: Path | None = None,
    devices: Path | None = None,
    maps: Sequence[str] = (),
    simulate: bool = False,
    capabilities: Path | None = None,
    doubled: Collection[str] = (),
) -> Mission:
    """Read, compile and check all files of a mission; raises ProgramError, BindingError and the like.

    The program is `NAME.L` in the folder of `NAME.dL`, the devices file `NAME.devices.yaml` and the mission's
    part of the registry `NAME.capabilities.yaml`, unless they are given. Access rules are in
    `NAME.access.yaml`. Agents that a test replaces (`doubled`) have no devices, and need neither bindings nor
    drivers.
    """
    _check_deployment(deploy)
    plugins = discover()
    types = _registry_types(capabilities or sibling_file(deploy, CAPABILITIES), deploy, plugins)
    hollow = _fully_doubled(deploy, doubled)
    literals: list[FileLiteral] = []
    loaded, warnings = _program(program or deploy.with_suffix(".L"), plugins, types, hollow, literals)
    deployment = read_deployment(deploy, loaded.units)
    team = team_of(deployment.rows, deployment.kinds, deployment.ports)
    needed = needed_devices(loaded, team)
    bindings = read_bindings(
        devices or sibling_file(deploy, DEVICES),
        needed,
        plugins,
        simulate=simulate,
        resources=team.types,
        hosts=team.hosts,
        attributes=lambda: types.registry.attributes,
        homes=team.homes,
        doubled=doubled,
    )
    if literals:
        from lfield.mission.checks.file_literals import check_files

        warnings += check_files(literals, bindings.all, team.types, plugins)
    drivers = drivers_for(plugins, {device.type for device in bindings.all})
    registry = restrict_to_program(types.registry, loaded, plugins, hollow) if realisations(loaded) else None
    chosen = chosen_fakes(bindings, without_doubles(needed, doubled), plugins, team.types) if simulate else []
    access = _access(deploy, team, loaded, types)
    mission = Mission(
        printable_argument(deploy.stem), loaded, team, bindings, drivers, registry, access=access
    )
    mission = check_recovery(mission, deployment)
    chosen += duplicate_statements(mission)
    warnings += quorum_warnings(deployment, mission)
    mission = replace(mission, warnings=(*(warning.render() for warning in warnings), *chosen))
    return mission.at(team.at(parse_maps(maps, team))) if maps else mission


def _access(deploy: Path, team: Team, program: Program, types: RegistryTypes) -> Access:
    """The access rules of a deployment, from its folder."""
    path = sibling_file(deploy, ACCESS)
    return NO_RULES if path is None else read_access(path, team.members, program, lambda: types.registry)


def _check_deployment(path: Path) -> None:
    """Reject other suffixes: the names of the other files follow from the deployment's name."""
    require_file(path)
    if path.suffix != ".dL":
        raise DamagedFileError(str(path), "neither a deployment (.dL) nor a bundle (.lfm)")


def open_mission(path: Path, devices: Path | None = None) -> Mission:
    """The mission in a bundle or of a deployment with its files; `devices` overrides its devices file.

    Raises the errors of the readers.
    """
    if path.suffix != bundle.SUFFIX:
        return load_mission(path, devices=devices)
    mission = bundle.read(path)
    return mission if devices is None else rebound(mission, devices)


def rebound(mission: Mission, devices: Path, *, simulate: bool = False) -> Mission:
    """A mission with the bindings of another devices file. Raises BindingError, InputFileError."""
    bindings = read_bindings(
        devices,
        mission.needed,
        mission.drivers,
        simulate=simulate,
        resources=mission.team.types,
        hosts=mission.team.hosts,
        attributes=(lambda: known.attributes) if (known := mission.registry) is not None else None,
        homes=mission.team.homes,
    )
    return check_recovery(mission.with_bindings(bindings))


def sibling_file(path: Path, suffix: str) -> Path | None:
    """The mission's file with another suffix, if it exists.

    A dangling link counts as existing: rules that were written must not be ignored. Raises InputFileError for
    a misspelt name.
    """
    found, nearly = path.with_suffix(suffix), path.with_suffix(suffix.replace(".yaml", ".yml"))
    if nearly != found and os.path.lexists(nearly):
        raise InputFileError(str(nearly), f"it is not read under this name; rename it to {found.name}")
    return found if os.path.lexists(found) else None


def _registry_types(mission: Path | None, deploy: Path | None, plugins: Plugins) -> RegistryTypes:
    """The registry with the mission's part; that of lfield is read only when a program names a capability.

    The mission's part is always checked. Raises ProgramError, InputFileError.
    """

    def read() -> Registry:
        from lfield.capability.registry_reader.registry_files import read_registry

        agents = None if deploy is None else agents_of(deploy)
        return read_registry(mission=mission, agents=agents, libraries=plugins.capabilities)

    if mission is None:
        return RegistryTypes(read)
    complete = read()
    return RegistryTypes(lambda: complete, own=mission)


def registry_of_program(path: Path, plugins: Plugins) -> RegistryTypes:
    """The registry of a program: that of lfield, with the mission's part beside the program."""
    return _registry_types(sibling_file(path, CAPABILITIES), sibling_file(path, ".dL"), plugins)


def _fully_doubled(deploy: Path, doubled: Collection[str]) -> frozenset[str]:
    """The resource types all of whose agents are replaced by a test: they execute no code."""
    agents = read_deployment(deploy, None).agents if doubled else ()
    run = {agent.type for agent in agents if agent.id not in doubled}
    return frozenset(agent.type for agent in agents if agent.type not in run)


def agents_of(deploy: Path) -> list[str] | None:
    """The ids of a deployment; None when it has errors, which its other readers report."""
    try:
        return [agent.id for agent in read_deployment(deploy, None).agents]
    except (ProgramError, InputFileError):
        return None


def _program(
    path: Path, plugins: Plugins, types: RegistryTypes, doubled: Collection[str], literals: list[FileLiteral]
) -> tuple[Program, list[Diagnostic]]:
    """The program, its warnings, and in `literals` the files that it names."""
    if path.suffix == ".L":
        checked, capabilities = check_program_file(path, plugins, types, doubled)
        return _compiled(checked, capabilities, plugins, doubled, literals), checked.diagnostics
    program = _read_program(path)
    if mistakes := _registry_misfits(types, program, plugins, doubled):
        raise ProgramError(mistakes)
    return program, []


def _registry_misfits(
    types: RegistryTypes, program: Program, plugins: Plugins, doubled: Collection[str]
) -> list[Diagnostic]:
    """Mismatches between the mission's own registry and the program."""
    return check_mission_registry(types.registry, types.own, program, plugins, doubled) if types.own else []


def load_program(path: Path) -> Program:
    """A program from L source, a program file, a deployment or a bundle, by the suffix of the path."""
    if path.suffix == ".dL":
        path = path.with_suffix(".L")
    if path.suffix == bundle.SUFFIX:
        return bundle.read(path).program
    return compile_file(path)[0] if path.suffix == ".L" else _read_program(path)


def _read_program(path: Path) -> Program:
    try:
        return decode(read_head(path, MAX_SIZE + 1))
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), error_reason(error)) from None
    except ProgramFileError as error:
        raise ProgramFileError(f"{path}: {error.reason}", method=error.method, pc=error.pc) from None


def check_program_file(
    path: Path, known: Plugins, types: RegistryTypes | None = None, doubled: Collection[str] = ()
) -> tuple[CheckResult, RegistryTypes]:
    """The checked syntax tree of L source, and its capabilities. Raises InputFileError."""
    from lfield.lang.frontend import check_file

    require_file(path)
    capabilities = types or registry_of_program(path, known)
    of_drivers, find = known.device_types, known.find_source
    checked = check_file(
        path, devices=of_drivers, find_include=find, capabilities=capabilities, doubled=doubled
    )
    return checked, capabilities


@_without_gc()
def compile_file(
    path: Path,
    plugins: Plugins | None = None,
    types: RegistryTypes | None = None,
    doubled: Collection[str] = (),
) -> tuple[Program, list[Diagnostic]]:
    """Compile L source; returns the program and its warnings, raises ProgramError with its errors.

    Its capabilities are those of `types`, else those of lfield and of `NAME.capabilities.yaml` in
    its folder. `doubled` are resource types that a test replaces.
    """
    known = plugins if plugins is not None else discover()
    checked, capabilities = check_program_file(path, known, types, doubled)
    return _compiled(checked, capabilities, known, doubled), checked.diagnostics


def _compiled(
    checked: CheckResult,
    capabilities: RegistryTypes,
    plugins: Plugins,
    doubled: Collection[str] = (),
    literals: list[FileLiteral] | None = None,
) -> Program:
    """The program of a checked syntax tree. Raises ProgramError with its errors."""
    from lfield.compiler.program_builder import compile_program
    from lfield.mission.checks.file_literals import embed_files

    if checked.program is None:
        raise ProgramError(checked.diagnostics)
    embedded = embed_files(checked.program, plugins)
    if literals is not None:
        literals += embedded.plans
    program = compile_program(checked.program)
    if embedded.areas:
        program = program.with_sources(embedded.areas)
    if mistakes := _registry_misfits(capabilities, program, plugins, doubled):
        raise ProgramError([*checked.diagnostics, *mistakes])
    return program


def mission_problems(deploy: Path) -> list[ReportableFinding]:
    """Findings between the files of a valid deployment. An unbound device is none: it may be simulated."""
    if (program := sibling_file(deploy, ".L")) is None:
        return []
    findings: list[ReportableFinding] = []
    bound, plugins = Bindings(), discover()
    try:
        if (devices := sibling_file(deploy, DEVICES)) is not None:
            complete = load_mission(deploy, simulate=True)
            findings += _without_fakes(complete, devices)
            findings += unstated_options(devices, complete.bindings, complete.drivers, complete.team.types)
            findings += [PlainFinding(message, "warning") for message in duplicate_statements(complete)]
            bound, loaded = complete.bindings, complete.program
        else:
            loaded = compile_file(program, plugins)[0]
        deployment = read_deployment(deploy, loaded.units)
        team = team_of(deployment.rows, deployment.kinds, deployment.ports)
        _access(deploy, team, loaded, _registry_types(sibling_file(deploy, CAPABILITIES), deploy, plugins))
        mission = check_recovery(
            Mission(printable_argument(deploy.stem), loaded, team, bound, DriverIndex({})), deployment
        )
    except ProgramError as error:
        return list(error.diagnostics)
    except BindingError as error:
        return [
            *error.findings,
            *(PlainFinding(problem) for problem in error.problems[len(error.findings) :]),
        ]
    return [*findings, *quorum_warnings(deployment, mission)]


def _without_fakes(mission: Mission, devices: Path) -> Sequence[ReportableFinding]:
    """Findings of a devices file with real devices, including unbound devices."""
    try:
        rebound(mission, devices)
    except BindingError as error:
        return error.findings or [PlainFinding(problem, "warning") for problem in error.problems]
    return []


def check_file(path: Path, inventory: Collection[str] = ()) -> Sequence[ReportableFinding]:
    """The findings of a program, or of a deployment with its program; `inventory`: hosts that have keys."""
    if path.suffix != ".dL":
        try:
            return compile_file(path)[1]
        except ProgramError as error:
            return error.diagnostics
    from lfield.lang.checker.argument_check import argument_findings

    require_file(path)
    program_path = path.with_suffix(".L")
    units: Mapping[str, UnitKind] | None = None
    checked: CheckResult | None = None
    findings: list[ReportableFinding] = []
    if program_path.exists():
        plugins = discover()
        try:
            checked, capabilities = check_program_file(program_path, plugins)
            units = _compiled(checked, capabilities, plugins).units
        except ProgramError as error:
            findings = list(error.diagnostics)
    try:
        deployment, warnings = read_with_warnings(path, units, inventory)
        findings += warnings
        if units is not None and checked is not None and checked.program is not None:
            findings += argument_findings(checked.program.units, deployment)
    except ProgramError as error:
        findings += error.diagnostics
    return findings
