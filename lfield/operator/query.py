"""The team as a question from outside sees it: from its files alone, or from what its running hosts tell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from lfield.capability.directory.directory import Deployed, live_attributes
from lfield.capability.model import Attribute, Registry
from lfield.capability.offer import Candidate, Fact
from lfield.capability.reading.reader import read_registry
from lfield.driver.plugins import discover
from lfield.errors import LfieldError, UsageError
from lfield.mission import bundle
from lfield.mission.load import CAPABILITIES, beside
from lfield.mission.team import Team
from lfield.operator.ask import Answers
from lfield.wire.observing import Status, Told

#: For each host, what its directory says of the agents.
Views = Mapping[str, Mapping[str, Told]]


class Roster:
    """Agents by resource type, in the order of the deployment. Implements `offer.Team`."""

    def __init__(self, candidates: Iterable[Candidate]) -> None:
        self._by_type: dict[str, list[Candidate]] = {}
        for candidate in candidates:
            self._by_type.setdefault(candidate.type, []).append(candidate)

    def candidates(self, resource: str) -> Sequence[Candidate]:
        """The agents of a resource type."""
        return self._by_type.get(resource, ())


def mission_registry(mission: Path, team: Team, capabilities: Path | None = None) -> Registry:
    """The registry of a mission: that of its bundle, or ours with `capabilities`, else the file beside it.

    Raises ProgramError, InputFileError and BundleError, and UsageError for a bundle that has none.
    """
    if mission.suffix == bundle.SUFFIX and capabilities is None:
        registry = bundle.read(mission).registry
        if registry is None:
            raise UsageError(
                f"the program of {mission} names no capability: ask its deployment (.dL) instead"
            )
        return registry
    added = capabilities or beside(mission, CAPABILITIES)
    return read_registry(
        mission=added,
        agents=[agent.id for agent in team.deployed],
        libraries=discover().capabilities,
    )


def from_files(registry: Registry, agents: Sequence[Deployed], at: str = "") -> Roster:
    """The agents as the files have them: what only devices could tell is not known.

    `at` is the host where the question is asked, for the count of hops; '' is none of them.
    """
    return Roster(
        _candidate(registry, agent, at, Told(agent.id, "", {}, {}), "the team is not running")
        for agent in _providers(registry, agents)
    )


def from_hosts(
    registry: Registry, agents: Sequence[Deployed], views: Views, silent: Collection[str], at: str = ""
) -> Roster:
    """The agents as the running hosts know them; the `silent` ones have not answered.

    Of each agent counts what the host `at` says, else what its own host says, else what any other does.
    """
    return Roster(
        _candidate(registry, agent, at, _view(agent, views, silent, at), "no host tells it")
        for agent in _providers(registry, agents)
    )


def views_of(answers: Answers[Status]) -> Views:
    """The directories of all hosts that answered."""
    return {
        host: {told.agent: told for told in answer.directory}
        for host, answer in answers.items()
        if not isinstance(answer, LfieldError)
    }


def _providers(registry: Registry, agents: Sequence[Deployed]) -> list[Deployed]:
    """The agents of a type that the registry knows."""
    return [agent for agent in agents if agent.type in registry.providers]


def _view(agent: Deployed, views: Views, silent: Collection[str], at: str) -> Told:
    for host in dict.fromkeys((at, agent.host, *views)):
        told = views.get(host, {}).get(agent.id)
        if told is not None:
            return told
    why = f"its host {agent.host} does not answer" if agent.host in silent else ""
    return Told(agent.id, why, {}, {})


def _candidate(registry: Registry, agent: Deployed, at: str, told: Told, why: str) -> Candidate:
    """An agent with its own values, and those live ones that are told and make sense."""
    facts = {name: Fact(value) for name, value in registry.agents.get(agent.id, {}).items()}
    unknown = {}
    for name in live_attributes(registry, agent):
        fact = told.facts.get(name)
        if fact is not None and _fits(fact.value, registry.attributes[name]):
            facts[name] = Fact(fact.value, fact.age)
        else:
            unknown[name] = told.unknown.get(name) or f"{name} is not known: {why}"
    hops = 0 if agent.host == at else 1
    return Candidate(agent.id, agent.type, agent.host, hops, told.refusal, facts, unknown)


def _fits(value: bool | int | float | str, attribute: Attribute) -> bool:
    """Whether a value that came is one of its attribute."""
    if isinstance(value, bool | str):
        return attribute.type == ("boolean" if isinstance(value, bool) else "text")
    return attribute.type in ("real", "int")
