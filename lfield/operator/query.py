"""The team as a question from outside sees it: from its files alone, or from what its running hosts tell."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from lfield.capability.directory.directory import Deployed, live_attributes
from lfield.capability.model import Attribute, Registry
from lfield.capability.offer import Candidate, Fact
from lfield.capability.reading.reader import read_registry
from lfield.errors import LfieldError, UsageError, WireError
from lfield.mission import bundle
from lfield.mission.load import CAPABILITIES, beside
from lfield.mission.team import Team

#: What a live attribute can be worth.
Scalar = bool | int | float | str


class Told(msgspec.Struct, frozen=True):
    """What a host's directory says of one agent (`Reporting.status`): facts have a value and an age."""

    refusal: str
    facts: dict[str, tuple[Scalar, float]]
    unknown: dict[str, str] = {}


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
    return read_registry(mission=added, agents=[agent.id for agent in team.deployed])


def from_files(registry: Registry, agents: Sequence[Deployed], at: str = "") -> Roster:
    """The agents as the files have them: what only devices could tell is not known.

    `at` is the host where the question is asked, for the count of hops; '' is none of them.
    """
    return Roster(
        _candidate(registry, agent, at, Told("", {}), "the team is not running")
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


def views_of(answers: Mapping[str, dict[str, Any] | LfieldError]) -> tuple[Views, dict[str, LfieldError]]:
    """The directories in the status of all hosts that answered, and what is the matter with the others."""
    views: dict[str, dict[str, Told]] = {}
    errors: dict[str, LfieldError] = {}
    for host, answer in answers.items():
        if isinstance(answer, LfieldError):
            errors[host] = answer
            continue
        try:
            views[host] = msgspec.convert(answer.get("directory", {}), dict[str, Told])
        except msgspec.ValidationError as error:
            errors[host] = WireError(f"{host} tells no directory that this lfield knows: {error}")
    return views, errors


def _providers(registry: Registry, agents: Sequence[Deployed]) -> list[Deployed]:
    """The agents of a type that the registry knows."""
    return [agent for agent in agents if agent.type in registry.providers]


def _view(agent: Deployed, views: Views, silent: Collection[str], at: str) -> Told:
    for host in dict.fromkeys((at, agent.host, *views)):
        told = views.get(host, {}).get(agent.id)
        if told is not None:
            return told
    return Told(f"its host {agent.host} does not answer" if agent.host in silent else "", {})


def _candidate(registry: Registry, agent: Deployed, at: str, told: Told, why: str) -> Candidate:
    """An agent with its own values, and those live ones that are told and make sense."""
    facts = {name: Fact(value) for name, value in registry.agents.get(agent.id, {}).items()}
    unknown = {}
    for name in live_attributes(registry, agent):
        value, age = told.facts.get(name, (None, 0.0))
        if value is not None and _fits(value, registry.attributes[name]):
            facts[name] = Fact(value, max(age, 0.0))
        else:
            unknown[name] = told.unknown.get(name) or f"{name} is not known: {why}"
    hops = 0 if agent.host == at else 1
    return Candidate(agent.id, agent.type, agent.host, hops, told.refusal, facts, unknown)


def _fits(value: Scalar, attribute: Attribute) -> bool:
    """Whether a value that came is one of its attribute."""
    if isinstance(value, bool | str):
        return attribute.type == ("boolean" if isinstance(value, bool) else "text")
    return attribute.type in ("real", "int")
