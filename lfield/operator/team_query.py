"""The team of a query, from the mission's files or from the reports of its running hosts; and the answer."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from msgspec import Struct, field

from lfield.capability.directory.agent_profile import AgentIdentity, AgentProfile, agent_profiles, location_of
from lfield.capability.matching.matcher import Matcher
from lfield.capability.model import Attribute, Primitive, Registry, Value
from lfield.capability.offer import Candidate, Fact, Offer, Position, Rejection
from lfield.capability.program_types.class_generator import UsableRealisations
from lfield.capability.program_types.program_check import check_against, satisfied
from lfield.capability.program_types.program_resources import resources_of
from lfield.capability.registry_reader.registry_files import is_shipped, read_registry
from lfield.capability.registry_reader.unit_signatures import Signature, signatures_of
from lfield.driver.plugins import discover
from lfield.errors import BindingError, InputFileError, ProgramError, UsageError
from lfield.mission import bundle
from lfield.mission.bindings import Frames, StatedValue
from lfield.mission.bindings_file import read_frames
from lfield.mission.loader import CAPABILITIES, DEVICES, load_mission, sibling_file
from lfield.mission.mission import Mission, with_poses
from lfield.mission.registry_check import program_files
from lfield.mission.registry_part import check_stated
from lfield.mission.team import Team
from lfield.operator.query_parser import CapabilityQuery
from lfield.operator.team_model.team_state import HostState
from lfield.text.source_text import Diagnostics
from lfield.vm.offer_objects import realisations
from lfield.wire.observer_messages import AttributeReading, DirectoryEntry

#: For each host, the agents in its directory.
DirectoryViews = Mapping[str, Mapping[str, DirectoryEntry]]


class Roster:
    """Agents by resource type, in the order of the deployment. Implements `offer.Team`.

    The position of the query is that of the first agent on the querying host, else that host's `pose`.
    """

    def __init__(
        self,
        candidates: Iterable[Candidate],
        attributes: Mapping[str, Attribute],
        pose: Position | None = None,
    ) -> None:
        self._by_type: dict[str, list[Candidate]] = {}
        found = list(candidates)
        for candidate in found:
            self._by_type.setdefault(candidate.type, []).append(candidate)
        self._place = location_of((candidate for candidate in found if candidate.hops == 0), attributes, pose)

    def location(self) -> Position | None:
        """The position of the querying host."""
        return self._place

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type."""
        return self._by_type.get(resource, ())


class QueryContext(Struct, frozen=True):
    """The inputs of a query: the registry as on the hosts, and the attributes that bindings state of agents.

    The registry is restricted to the resources of the program. `realisations` are the possible providers of
    each primitive; None if the program could not be compiled. `frames` are the places of hosts; those of
    agents are in the registry.
    """

    registry: Registry
    realisations: Mapping[str, Collection[str]] | None = None
    stated: Mapping[str, Mapping[str, StatedValue]] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)


def read_context(path: Path, team: Team, capabilities: Path | None = None) -> QueryContext:
    """Reads the context from the files of a mission.

    If other parts of the deployment have errors, only the registry and the places of agents are read: from
    `capabilities`, else from the file in the deployment's folder. Raises ProgramError, BindingError,
    InputFileError, BundleError, and UsageError for a bundle without a registry.
    """
    own = capabilities
    if path.suffix != bundle.SUFFIX:
        own = own or sibling_file(path, CAPABILITIES)
        try:
            mission = load_mission(path, simulate=True, capabilities=own)
        except (ProgramError, BindingError, InputFileError):
            return _partial_context(path, team, own)
        registry = mission.registry
    else:
        mission = bundle.read(path)
        registry = mission.registry if own is None else None
        if registry is None and own is None:
            raise UsageError(f"the program of {path} names no capability: ask its deployment (.dL) instead")
    return _context(mission, registry or _registry(own, team, resources_of(mission.program)))


def _context(mission: Mission, registry: Registry) -> QueryContext:
    """The context with the realisations that the program was built with, and the possible ones of other
    primitives.
    """
    program, bindings = mission.program, mission.bindings
    resources = resources_of(program)
    fitting = satisfied(registry, resources)
    check_stated(bindings.attributes, fitting)
    return QueryContext(
        with_poses(fitting, mission.team.types, bindings.frames),
        {**UsableRealisations(fitting, resources).all_realisations(), **realisations(program)},
        bindings.attributes,
        bindings.frames,
    )


def _partial_context(path: Path, team: Team, own: Path | None) -> QueryContext:
    """The context of a deployment with errors: all realisations are open to the readable resources."""
    program = sibling_file(path, ".L")
    files = [] if program is None else program_files(program, discover(), Diagnostics())
    registry = _registry(own, team, signatures_of([file for file in files if not file.broken]))
    frames = read_frames(sibling_file(path, DEVICES), team.homes)
    return QueryContext(with_poses(registry, team.types, frames), frames=frames)


def _registry(own: Path | None, team: Team, resources: Mapping[str, Signature]) -> Registry:
    """The registry from its files, as far as these resources fulfil it: a mission's `own` file must fit."""
    agents = [agent.id for agent in team.deployed]
    registry, found = (
        read_registry(mission=own, agents=agents, libraries=discover().capabilities),
        Diagnostics(),
    )
    check_against(registry, resources, found)
    if mistakes := [mistake for mistake in found.in_order() if not is_shipped(mistake)]:
        raise ProgramError(mistakes)
    return satisfied(registry, resources)


def roster_from_files(
    registry: Registry,
    agents: Sequence[AgentIdentity],
    at: str = "",
    stated: Mapping[str, Mapping[str, StatedValue]] = MappingProxyType({}),
    pose: Position | None = None,
) -> Roster:
    """The agents from the files; attributes that only devices report are unknown.

    `stated` are the attributes from their bindings, `at` the querying host ('' for none), for the number of
    hops, and `pose` its place.
    """
    candidates = (
        known.candidate(
            _hops(known, at),
            "",
            {name: Fact(_value(value)) for name, value in stated.get(known.agent.id, {}).items()},
            {},
            "{0} is not known: the team is not running",
        )
        for known in agent_profiles(registry, agents).values()
    )
    return Roster(candidates, registry.attributes, pose)


def roster_from_hosts(
    registry: Registry,
    agents: Sequence[AgentIdentity],
    views: DirectoryViews,
    unanswered: Collection[str],
    at: str = "",
    pose: Position | None = None,
) -> Roster:
    """The agents as the running hosts know them; the `unanswered` ones have not answered.

    For each agent the directory of the host `at` counts, as for a program on that host; without `at` that of
    its own host, else that of any other. `pose` is the place of that host in the devices file.
    """
    found = (
        _candidate(registry, known, at, _view(known.agent, views, unanswered, at))
        for known in agent_profiles(registry, agents).values()
    )
    return Roster(found, registry.attributes, pose)


def directory_views(hosts: Mapping[str, HostState]) -> DirectoryViews:
    """The directories of all hosts that answered."""
    return {
        name: {entry.agent: entry for entry in host.report.directory}
        for name, host in hosts.items()
        if host.linked
    }


def _view(
    agent: AgentIdentity, views: DirectoryViews, unanswered: Collection[str], at: str
) -> DirectoryEntry:
    for host in (at,) if at else dict.fromkeys((agent.host, *views)):
        view = views.get(host, {}).get(agent.id)
        if view is not None:
            return view
    reason = f"its host {agent.host} does not answer" if agent.host in unanswered else ""
    return DirectoryEntry(agent.id, reason, {}, {})


def _candidate(registry: Registry, known: AgentProfile, at: str, reported: DirectoryEntry) -> Candidate:
    """An agent with the valid part of a host's report."""
    facts = {name: _fact(fact) for name, fact in reported.facts.items()}
    known_as = registry.attributes
    facts = {
        name: fact for name, fact in facts.items() if name in known_as and known_as[name].accepts(fact.value)
    }
    return known.candidate(
        _hops(known, at), reported.refusal, facts, reported.unknown, "{0} is unknown: no host reports it"
    )


def _hops(known: AgentProfile, at: str) -> int:
    return 0 if known.agent.host == at else 1


def _fact(reported: AttributeReading) -> Fact:
    return Fact(_value(reported.value), reported.age, reported.of)


def _value(value: float | str | list[str] | tuple[str, ...]) -> Value:
    """A value as the registry has it: members are a set."""
    return frozenset(value) if isinstance(value, list | tuple) else value


class PrimitiveAnswer(Struct, frozen=True):
    """The providers of a primitive, best first, their number, and the refusals of other agents.

    `teams` are the best teams of these offers if requested, from `agents` candidates. `notes` are the
    omissions.
    """

    primitive: Primitive
    offers: Sequence[Offer]
    count: int
    refusals: Sequence[Rejection]
    notes: Sequence[str] = ()
    teams: Sequence[Sequence[Offer]] | None = None
    agents: int = 0
    is_truncated: bool = False


def primitive_answer(
    matcher: Matcher, primitive: Primitive, question: CapabilityQuery, size: int | None = None
) -> PrimitiveAnswer:
    """The answer for one primitive of a query; with a `size` also the best teams of so many agents."""
    found = matcher.find(primitive.name, question.offer_query)
    refusals = matcher.explain(primitive.name, question.constraint)
    if size is None:
        return PrimitiveAnswer(
            primitive, found.offers, found.count, refusals, found.notes, is_truncated=bool(found.cut)
        )
    formed = matcher.teams(primitive.name, size, question.offer_query)
    notes = list(dict.fromkeys([*found.notes, *formed.notes]))
    return PrimitiveAnswer(
        primitive, found.offers, found.count, refusals, notes, formed.teams, formed.agents, bool(found.cut)
    )
