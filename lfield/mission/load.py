"""From files to a mission, on the desk: the only part of the runtime that needs the compiler."""

from __future__ import annotations

import gc
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from lfield.bytecode.encoding import MAX_SIZE, decode
from lfield.bytecode.program import Program, UnitKind
from lfield.capability.model import Registry
from lfield.capability.types.compiled import promised_wrongly, settled
from lfield.capability.types.language import RegistryTypes
from lfield.driver.known import KnownDrivers
from lfield.driver.plugins import Plugins, discover
from lfield.errors import (
    BindingError,
    DamagedFileError,
    Finding,
    InputFileError,
    ProgramError,
    ProgramFileError,
)
from lfield.lang.deployment import DeployedAgent, Deployment, read_deployment
from lfield.mission import bundle
from lfield.mission.access.access_file import read_access
from lfield.mission.access.rules import UNWRITTEN, Access
from lfield.mission.bindings import Bindings, chosen_fakes, undoubled
from lfield.mission.bindings_file import read_bindings
from lfield.mission.mission import Mission, makers_of, needed_devices
from lfield.mission.team import Team, parse_maps, team_of
from lfield.text.files import look_at, read_head, reason
from lfield.text.source import Diagnostic, Remark
from lfield.text.suggest import listed
from lfield.text.visible import as_text
from lfield.vm.offers import ways

#: Suffixes of the files of a mission that stand beside its deployment.
DEVICES, CAPABILITIES, ACCESS = ".devices.yaml", ".capabilities.yaml", ".access.yaml"


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without Python's collector: trees, tables and registries stay until all is done.

    It would go through them again and again, the longer a program is the more often.
    """
    running = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if running:
            gc.enable()


@_uncollected()
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

    The program is `NAME.L` beside `NAME.dL`, the devices `NAME.devices.yaml`, what the mission adds to the
    registry `NAME.capabilities.yaml`, unless they are given. Who may do what is in `NAME.access.yaml`. Agents
    that are `doubled` by a test have no devices, and need neither bindings nor drivers.
    """
    _check_deployment(deploy)
    plugins = discover()
    types = _registry_types(capabilities or beside(deploy, CAPABILITIES), deploy, plugins)
    hollow = _hollow(deploy, doubled)
    loaded, warnings = _program(program or deploy.with_suffix(".L"), plugins, types, hollow)
    deployment = read_deployment(deploy, loaded.units)
    team = team_of(deployment.rows, deployment.kinds, deployment.ports)
    needed = needed_devices(loaded, team)
    bindings = read_bindings(
        devices or beside(deploy, DEVICES),
        needed,
        plugins,
        simulate=simulate,
        resources=team.types,
        hosts=team.hosts,
        attributes=lambda: types.registry.attributes,
        homes=team.homes,
        doubled=doubled,
    )
    drivers = makers_of(plugins, {device.type for device in bindings.all})
    registry = settled(types.registry, loaded, plugins, hollow) if ways(loaded) else None
    chosen = chosen_fakes(bindings, undoubled(needed, doubled), plugins, team.types) if simulate else []
    access = _access(deploy, team, loaded, types)
    mission = Mission(as_text(deploy.stem), loaded, team, bindings, drivers, registry, access=access)
    mission = _decided(mission, deployment)
    chosen += _stated_twice(mission)
    warnings += _doubts(deployment, mission)
    mission = replace(mission, warnings=(*(warning.render() for warning in warnings), *chosen))
    return mission.at(team.at(parse_maps(maps, team))) if maps else mission


def _access(deploy: Path, team: Team, program: Program, types: RegistryTypes) -> Access:
    """Who may do what, by the file beside a deployment."""
    path = beside(deploy, ACCESS)
    return UNWRITTEN if path is None else read_access(path, team.members, program, lambda: types.registry)


def _stated_twice(mission: Mission) -> list[str]:
    """What the devices file states of an agent and the mission's registry or its frame, too, a line each."""
    own, placed = mission.registry, mission.stated
    if own is None or placed is None:
        return []
    return [
        f"{name} of {agent} is stated in the devices file and {_where(own, agent, name)}, which counts"
        for agent, values in mission.bindings.attributes.items()
        for name in values
        if name in placed.agents.get(agent, {})
    ]


def _where(own: Registry, agent: str, name: str) -> str:
    """What else states an attribute of an agent."""
    return "in the mission's registry" if name in own.agents.get(agent, {}) else "by its frame there"


def _doubts(deployment: Deployment, mission: Mission) -> list[Diagnostic]:
    """Of one member or of two, none may be lost: more than half of two is both of them."""
    members, team = mission.recovery.members, mission.team
    if len(members) == 1 and any(team.on(n) for n, host in enumerate(team.hosts) if host not in members):
        lost, why = members[0], "no other host decides"
    elif len(members) == 2:
        lost, why = f"one of {listed(members)}", "the other is no more than half"
    else:
        return []
    first = _first_fenced(deployment, mission)
    message = f"{first.id} goes on nowhere when {lost} is lost: {why}"
    return [Diagnostic("Y114", message, first.span, _more_members(mission), "warning")]


def _more_members(mission: Mission) -> str:
    """How a team gets members enough to lose one."""
    witness = "add a witness, a host without agents: //@name"
    if not mission.bindings.recovery.members:
        return witness
    named = "name at least three hosts in 'recovery: {members: [...]}' of the devices file"
    return named if len(mission.team.hosts) > 2 else f"{witness}; and {named}"


def _check_deployment(path: Path) -> None:
    """From a deployment's name are those of its other files made: another kind is told as what it is."""
    look_at(path)
    if path.suffix != ".dL":
        raise DamagedFileError(str(path), "neither a deployment (.dL) nor a bundle (.lfm)")


def open_mission(path: Path, devices: Path | None = None) -> Mission:
    """The mission in a bundle, or of a deployment with its files; `devices` has other bindings than theirs.

    Raises as those do that read them.
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
    return _decided(mission.with_bindings(bindings))


def _decided(mission: Mission, deployment: Deployment | None = None) -> Mission:
    """The mission, if it says who decides that a coordinator is lost, and no device outlives a lease.

    Raises BindingError, drawn at the first coordinator that needs it where the deployment is at hand.
    """
    try:
        if mission.recovery.members:
            mission.bindings.see_that_nothing_outlives_a_lease()
    except BindingError as error:
        if deployment is None:
            raise
        drawn = Diagnostic("Y115", str(error), _first_fenced(deployment, mission).span)
        raise BindingError([drawn.render()], [drawn]) from None
    return mission


def _first_fenced(deployment: Deployment, mission: Mission) -> DeployedAgent:
    return next(agent for agent in deployment.agents if agent.id in mission.fenced)


def beside(path: Path, suffix: str) -> Path | None:
    """The mission's file with another suffix, if there is one.

    A link that leads nowhere is one: who has written rules is not to fly without them. Raises InputFileError
    for a name that is nearly right.
    """
    found, nearly = path.with_suffix(suffix), path.with_suffix(suffix.replace(".yaml", ".yml"))
    if nearly != found and os.path.lexists(nearly):
        raise InputFileError(str(nearly), f"it is not read under this name: call it {found.name}")
    return found if os.path.lexists(found) else None


def _registry_types(mission: Path | None, deploy: Path | None, plugins: Plugins) -> RegistryTypes:
    """The registry with what a mission adds to it; ours alone is read only when a program names a capability.

    What the mission adds is looked at in any case: whoever has written it wants to hear what is wrong there.
    Raises ProgramError, InputFileError.
    """

    def read() -> Registry:
        from lfield.capability.reading.reader import read_registry

        agents = None if deploy is None else agents_of(deploy)
        return read_registry(mission=mission, agents=agents, libraries=plugins.capabilities)

    if mission is None:
        return RegistryTypes(read)
    whole = read()
    return RegistryTypes(lambda: whole, own=mission)


def _hollow(deploy: Path, doubled: Collection[str]) -> frozenset[str]:
    """The resource types all of whose agents are doubled: nothing of them runs."""
    agents = read_deployment(deploy, None).agents if doubled else ()
    run = {agent.type for agent in agents if agent.id not in doubled}
    return frozenset(agent.type for agent in agents if agent.type not in run)


def agents_of(deploy: Path) -> list[str] | None:
    """The ids of a deployment; None when it has mistakes: whoever needs the rest of it reports them."""
    try:
        return [agent.id for agent in read_deployment(deploy, None).agents]
    except (ProgramError, InputFileError):
        return None


def _program(
    path: Path, plugins: Plugins, types: RegistryTypes, doubled: Collection[str]
) -> tuple[Program, list[Diagnostic]]:
    if path.suffix == ".L":
        return compile_file(path, plugins, types, doubled)
    program = _read_program(path)
    if mistakes := _promised_wrongly(types, program, plugins, doubled):
        raise ProgramError(mistakes)
    return program, []


def _promised_wrongly(
    types: RegistryTypes, program: Program, plugins: Plugins, doubled: Collection[str]
) -> list[Diagnostic]:
    """Where the registry that a mission has of its own does not fit the program."""
    return promised_wrongly(types.registry, types.own, program, plugins, doubled) if types.own else []


def load_program(path: Path) -> Program:
    """A program from L text, from a program file, or that of a deployment or bundle, as the path names."""
    if path.suffix == ".dL":
        path = path.with_suffix(".L")
    if path.suffix == bundle.SUFFIX:
        return bundle.read(path).program
    return compile_file(path)[0] if path.suffix == ".L" else _read_program(path)


def _read_program(path: Path) -> Program:
    try:
        return decode(read_head(path, MAX_SIZE + 1))
    except (OSError, ValueError) as error:
        raise InputFileError(str(path), reason(error)) from None
    except ProgramFileError as error:
        raise ProgramFileError(f"{path}: {error.reason}", method=error.method, pc=error.pc) from None


@_uncollected()
def compile_file(
    path: Path,
    plugins: Plugins | None = None,
    types: RegistryTypes | None = None,
    doubled: Collection[str] = (),
) -> tuple[Program, list[Diagnostic]]:
    """Compile L text; returns the program and its warnings, raises ProgramError with its errors.

    Its capabilities are those of `types`, else those of lfield and of `NAME.capabilities.yaml` beside it.
    `doubled` are the resource types of which nothing will run.
    """
    from lfield.compiler.build import compile_program
    from lfield.lang.frontend import check_file as check_program

    look_at(path)
    known = plugins if plugins is not None else discover()
    capabilities = types or _registry_types(beside(path, CAPABILITIES), beside(path, ".dL"), known)
    checked = check_program(
        path,
        devices=known.device_types,
        find_include=known.find_source,
        capabilities=capabilities,
        doubled=doubled,
    )
    if checked.program is None:
        raise ProgramError(checked.diagnostics)
    program = compile_program(checked.program)
    if mistakes := _promised_wrongly(capabilities, program, known, doubled):
        raise ProgramError([*checked.diagnostics, *mistakes])
    return program, checked.diagnostics


def mission_problems(deploy: Path) -> list[Finding]:
    """What is found between the files of a deployment that has no mistakes itself.

    That a device is not bound is no error: it may be simulated.
    """
    program = beside(deploy, ".L")
    if program is None:
        return []
    found: list[Finding] = []
    bound = Bindings()
    try:
        if (devices := beside(deploy, DEVICES)) is not None:
            whole = load_mission(deploy, simulate=True)
            found += _without_fakes(whole, devices)
            found += [Remark(told, "warning") for told in _stated_twice(whole)]
            bound = whole.bindings
        loaded = compile_file(program)[0]
        deployment = read_deployment(deploy, loaded.units)
        team = team_of(deployment.rows, deployment.kinds, deployment.ports)
        _access(deploy, team, loaded, _registry_types(beside(deploy, CAPABILITIES), deploy, discover()))
        mission = _decided(Mission(as_text(deploy.stem), loaded, team, bound, KnownDrivers({})), deployment)
    except ProgramError as error:
        return list(error.diagnostics)
    except BindingError as error:
        return [*error.findings, *(Remark(problem) for problem in error.problems[len(error.findings) :])]
    return [*found, *_doubts(deployment, mission)]


def _without_fakes(mission: Mission, devices: Path) -> Sequence[Finding]:
    """What is wrong with a devices file where its devices are not simulated, and what it does not bind."""
    try:
        rebound(mission, devices)
    except BindingError as error:
        return error.findings or [Remark(problem, "warning") for problem in error.problems]
    return []


def check_file(path: Path) -> Sequence[Finding]:
    """The findings of a program, or of a deployment (against the program beside it, if there is one)."""
    if path.suffix != ".dL":
        try:
            return compile_file(path)[1]
        except ProgramError as error:
            return error.diagnostics
    look_at(path)
    beside = path.with_suffix(".L")
    units: Mapping[str, UnitKind] | None = None
    found: list[Finding] = []
    if beside.exists():
        try:
            units = compile_file(beside)[0].units
        except ProgramError as error:
            found = list(error.diagnostics)
    try:
        read_deployment(path, units)
    except ProgramError as error:
        found += error.diagnostics
    return found
