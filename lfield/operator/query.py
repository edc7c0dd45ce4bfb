"""The team as a question from outside sees it: from its files alone, or from what its running hosts tell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from lfield.capability.directory.showing import Deployed, Known, known_agents, place_of
from lfield.capability.model import Attribute, Registry, Value
from lfield.capability.offer import Candidate, Fact, Place
from lfield.capability.reading.reader import is_shipped, read_registry
from lfield.capability.reading.signatures import Signature, signatures_of
from lfield.capability.types.compiled import resources_of
from lfield.capability.types.generate import Served
from lfield.capability.types.program_check import check_against, fulfilled
from lfield.driver.plugins import discover
from lfield.errors import BindingError, InputFileError, LfieldError, ProgramError, UsageError
from lfield.mission import bundle
from lfield.mission.bindings import Frames, Stated
from lfield.mission.bindings_file import read_frames
from lfield.mission.load import CAPABILITIES, DEVICES, beside, load_mission
from lfield.mission.mission import Mission, placed
from lfield.mission.registry_check import program_files
from lfield.mission.registry_part import check_stated
from lfield.mission.team import Team
from lfield.operator.ask import Answers
from lfield.text.source import Diagnostics
from lfield.vm.offers import ways
from lfield.wire.observing import Status, Told, ToldFact

#: For each host, what its directory says of the agents.
Views = Mapping[str, Mapping[str, Told]]


class Roster:
    """Agents by resource type, in the order of the deployment. Implements `offer.Team`.

    Where is asked: where the first agent is whose host is the one that asks, else at that host's `pose`.
    """

    def __init__(
        self,
        candidates: Iterable[Candidate],
        attributes: Mapping[str, Attribute],
        pose: Place | None = None,
    ) -> None:
        self._by_type: dict[str, list[Candidate]] = {}
        found = list(candidates)
        for candidate in found:
            self._by_type.setdefault(candidate.type, []).append(candidate)
        self._place = place_of((candidate for candidate in found if candidate.hops == 0), attributes, pose)

    def here(self) -> Place | None:
        """Where the host is that asks."""
        return self._place

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type."""
        return self._by_type.get(resource, ())


@dataclass(frozen=True, slots=True)
class Asked:
    """What is asked about: the registry as hosts have it, and what their bindings state of single agents.

    The registry is as far as the program fulfils it. `ways` are those by which that can have each primitive
    served; None where it could not be compiled.
    `frames` say where hosts are; where agents are is in the registry.
    """

    registry: Registry
    ways: Mapping[str, Collection[str]] | None = None
    stated: Mapping[str, Mapping[str, Stated]] = field(default_factory=dict)
    frames: Frames = field(default_factory=Frames)


def read_asked(path: Path, team: Team, capabilities: Path | None = None) -> Asked:
    """The same as the hosts of a mission have it, from the same files.

    Of a deployment that has mistakes elsewhere the registry and where agents are, alone: ours with
    `capabilities`, else the file beside it. Raises ProgramError, BindingError, InputFileError and
    BundleError, and UsageError for a bundle without one.
    """
    own = capabilities
    if path.suffix != bundle.SUFFIX:
        own = own or beside(path, CAPABILITIES)
        try:
            mission = load_mission(path, simulate=True, capabilities=own)
        except (ProgramError, BindingError, InputFileError):
            return _in_spite_of_mistakes(path, team, own)
        registry = mission.registry
    else:
        mission = bundle.read(path)
        registry = mission.registry if own is None else None
        if registry is None and own is None:
            raise UsageError(f"the program of {path} names no capability: ask its deployment (.dL) instead")
    return _asked(mission, registry or _registry(own, team, resources_of(mission.program)))


def _asked(mission: Mission, registry: Registry) -> Asked:
    """The ways that the program was built with; of what it does not name those it would have."""
    program, bindings = mission.program, mission.bindings
    resources = resources_of(program)
    fitting = fulfilled(registry, resources)
    check_stated(bindings.attributes, fitting)
    return Asked(
        placed(fitting, mission.team.types, bindings.frames),
        {**Served(fitting, resources).all_ways(), **ways(program)},
        bindings.attributes,
        bindings.frames,
    )


def _in_spite_of_mistakes(path: Path, team: Team, own: Path | None) -> Asked:
    """What can be had of a deployment: all ways are open to the resources, as far as they can be read."""
    program = beside(path, ".L")
    files = [] if program is None else program_files(program, discover(), Diagnostics())
    registry = _registry(own, team, signatures_of([file for file in files if not file.broken]))
    frames = read_frames(beside(path, DEVICES), team.homes)
    return Asked(placed(registry, team.types, frames), frames=frames)


def _registry(own: Path | None, team: Team, resources: Mapping[str, Signature]) -> Registry:
    """The registry from its files, as far as these resources fulfil it: a mission's `own` file must fit."""
    agents = [agent.id for agent in team.deployed]
    registry, found = (
        read_registry(mission=own, agents=agents, libraries=discover().capabilities),
        Diagnostics(),
    )
    check_against(registry, resources, found)
    if wrong := [mistake for mistake in found.in_order() if not is_shipped(mistake)]:
        raise ProgramError(wrong)
    return fulfilled(registry, resources)


def from_files(
    registry: Registry,
    agents: Sequence[Deployed],
    at: str = "",
    stated: Mapping[str, Mapping[str, Stated]] = MappingProxyType({}),
    pose: Place | None = None,
) -> Roster:
    """The agents as the files have them: what only devices could tell is not known.

    `stated` is what their bindings say, `at` the host where the question is asked, for the count of hops, ''
    for none of them, and `pose` where that host is.
    """
    found = (
        known.shown(
            _hops(known, at),
            "",
            {name: Fact(_value(said)) for name, said in stated.get(known.agent.id, {}).items()},
            {},
            "{0} is not known: the team is not running",
        )
        for known in known_agents(registry, agents).values()
    )
    return Roster(found, registry.attributes, pose)


def from_hosts(
    registry: Registry,
    agents: Sequence[Deployed],
    views: Views,
    silent: Collection[str],
    at: str = "",
    pose: Place | None = None,
) -> Roster:
    """The agents as the running hosts know them; the `silent` ones have not answered.

    Of each agent counts what the host `at` says, as it does when a program asks there; without one what its
    own host says, else what any other does. `pose` is where that host is by the devices file.
    """
    found = (
        _candidate(registry, known, at, _view(known.agent, views, silent, at))
        for known in known_agents(registry, agents).values()
    )
    return Roster(found, registry.attributes, pose)


def views_of(answers: Answers[Status]) -> Views:
    """The directories of all hosts that answered."""
    return {
        host: {told.agent: told for told in answer.directory}
        for host, answer in answers.items()
        if not isinstance(answer, LfieldError)
    }


def _view(agent: Deployed, views: Views, silent: Collection[str], at: str) -> Told:
    for host in (at,) if at else dict.fromkeys((agent.host, *views)):
        told = views.get(host, {}).get(agent.id)
        if told is not None:
            return told
    why = f"its host {agent.host} does not answer" if agent.host in silent else ""
    return Told(agent.id, why, {}, {})


def _candidate(registry: Registry, known: Known, at: str, told: Told) -> Candidate:
    """An agent with what a host has told of it, as far as it makes sense."""
    facts = {name: _fact(fact) for name, fact in told.facts.items()}
    known_as = registry.attributes
    facts = {
        name: fact for name, fact in facts.items() if name in known_as and known_as[name].takes(fact.value)
    }
    return known.shown(
        _hops(known, at), told.refusal, facts, told.unknown, "{0} is not known: no host tells it"
    )


def _hops(known: Known, at: str) -> int:
    return 0 if known.agent.host == at else 1


def _fact(told: ToldFact) -> Fact:
    return Fact(_value(told.value), told.age, told.of)


def _value(said: float | str | list[str] | tuple[str, ...]) -> Value:
    """A value as the registry has it: members are a set."""
    return frozenset(said) if isinstance(said, list | tuple) else said
