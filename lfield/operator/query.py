"""The team as a question from outside sees it: from its files alone, or from what its running hosts tell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from lfield.bytecode.program import Program
from lfield.capability.directory.showing import Deployed, Known, known_agents, place_of
from lfield.capability.model import Attribute, Registry
from lfield.capability.offer import Candidate, Fact, Place
from lfield.capability.reading.reader import read_registry
from lfield.capability.types.generate import all_ways
from lfield.driver.plugins import discover
from lfield.errors import LfieldError, UsageError
from lfield.mission import bundle
from lfield.mission.load import registry_of
from lfield.mission.team import Team
from lfield.operator.ask import Answers
from lfield.vm.offers import ways
from lfield.wire.observing import Status, Told, ToldFact

#: For each host, what its directory says of the agents.
Views = Mapping[str, Mapping[str, Told]]


class Roster:
    """Agents by resource type, in the order of the deployment. Implements `offer.Team`.

    Where is asked: where the first agent is whose host is the one that asks.
    """

    def __init__(self, candidates: Iterable[Candidate], attributes: Mapping[str, Attribute]) -> None:
        self._by_type: dict[str, list[Candidate]] = {}
        found = list(candidates)
        for candidate in found:
            self._by_type.setdefault(candidate.type, []).append(candidate)
        self._place = place_of((candidate for candidate in found if candidate.hops == 0), attributes)

    def here(self) -> Place | None:
        """Where the host is that asks."""
        return self._place

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type."""
        return self._by_type.get(resource, ())


#: For each primitive the ways by which it is served, as a matcher wants them; None for all.
Ways = Mapping[str, Collection[str]]


def mission_registry(
    mission: Path, team: Team, capabilities: Path | None = None
) -> tuple[Registry, Ways | None]:
    """The registry of a mission as its hosts have it, and the ways that are open to its program.

    It is that of its bundle, or ours with `capabilities`, else the file beside it. Where no program can be
    had, all ways are open. Raises ProgramError, InputFileError and BundleError, and UsageError for a bundle
    that has none.
    """
    if mission.suffix != bundle.SUFFIX:
        registry, program = registry_of(mission, capabilities)
        return registry, None if program is None else _open(registry, program)
    built = bundle.read(mission)
    if capabilities is not None:
        agents = [agent.id for agent in team.deployed]
        libraries = discover().capabilities
        return read_registry(mission=capabilities, agents=agents, libraries=libraries), None
    if built.registry is None:
        raise UsageError(f"the program of {mission} names no capability: ask its deployment (.dL) instead")
    return built.registry, _open(built.registry, built.program)


def _open(registry: Registry, program: Program) -> Ways:
    """The ways that the program was built with; of what it does not name those it would have."""
    resources = [name for name, kind in program.units.items() if kind == "resource"]
    return {**all_ways(registry, resources), **ways(program)}


def from_files(registry: Registry, agents: Sequence[Deployed], at: str = "") -> Roster:
    """The agents as the files have them: what only devices could tell is not known.

    `at` is the host where the question is asked, for the count of hops; '' is none of them.
    """
    found = (
        known.shown(_hops(known, at), "", {}, {}, "{0} is not known: the team is not running")
        for known in known_agents(registry, agents).values()
    )
    return Roster(found, registry.attributes)


def from_hosts(
    registry: Registry, agents: Sequence[Deployed], views: Views, silent: Collection[str], at: str = ""
) -> Roster:
    """The agents as the running hosts know them; the `silent` ones have not answered.

    Of each agent counts what the host `at` says, as it does when a program asks there; without one what its
    own host says, else what any other does.
    """
    found = (
        _candidate(registry, known, at, _view(known.agent, views, silent, at))
        for known in known_agents(registry, agents).values()
    )
    return Roster(found, registry.attributes)


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
    facts = {name: fact for name, fact in facts.items() if _fits(fact, registry.attributes.get(name))}
    return known.shown(
        _hops(known, at), told.refusal, facts, told.unknown, "{0} is not known: no host tells it"
    )


def _hops(known: Known, at: str) -> int:
    return 0 if known.agent.host == at else 1


def _fact(told: ToldFact) -> Fact:
    value = frozenset(told.value) if isinstance(told.value, list) else told.value
    return Fact(value, told.age, told.of)


def _fits(fact: Fact, attribute: Attribute | None) -> bool:
    """Whether a value that came is one of its attribute."""
    match fact.value:
        case _ if attribute is None:
            return False
        case bool():
            return attribute.type == "boolean"
        case str():
            return attribute.type == "text"
        case frozenset():
            return attribute.type == "set"
        case _:
            return attribute.type in ("real", "int")
