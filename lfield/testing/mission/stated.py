"""The live attributes of a resource that has a double: what the double says of them.

A double has no devices whose telemetry they could be. It says them by an attribute `live_attributes`, a dict
of their names and values, or a method that gives one whenever the host looks; in the units of the registry
(chapter IV). What it does not say is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from lfield.capability.directory.directory import live_attributes
from lfield.capability.directory.news import Condition, Sample
from lfield.capability.model import AttributeType
from lfield.errors import DoubleError
from lfield.mission.mission import Mission
from lfield.simulate.fleet import Life
from lfield.text.suggest import did_you_mean, listed
from lfield.vm.agent import Member

#: Where a double says them.
NAME = "live_attributes"


def tells(double: object) -> bool:
    """Whether it says any; nothing that makes attributes when it is asked for them, as a mock, is asked."""
    return NAME in dir(double)


def check(mission: Mission, member: Member, double: object) -> None:
    """Raises DoubleError for a dict that says what its resource has not; a method is asked later."""
    told = getattr(double, NAME) if tells(double) else {}
    if not callable(told):
        _samples(mission, member, told, 0.0)


def attach(
    mission: Mission, member: Member, life: Life, double: object, trouble: list[BaseException]
) -> None:
    """Let a host tell its team what the double says, in this life of it; what goes wrong is `trouble`."""
    directory, clock = life.core.directory.directory, life.host.clock
    own = directory.own

    def say(agent: str, condition: Condition) -> None:
        if agent == member.id:
            samples = said()
            silent = f"the double of {agent} does not say it"
            unknown = {name: silent for name in condition.unknown if name not in samples}
            condition = replace(condition, samples=samples, unknown=unknown)
        own(agent, condition)

    def said() -> dict[str, Sample]:
        try:
            told = getattr(double, NAME)
            return _samples(mission, member, told() if callable(told) else told, clock.monotonic())
        except Exception as error:  # the double is the test's: it is told, and the host never
            trouble.append(error)
            return {}

    directory.own = say  # type: ignore[method-assign]


def _samples(mission: Mission, member: Member, told: object, now: float) -> dict[str, Sample]:
    """What is said, as of now. Raises DoubleError."""
    if not isinstance(told, Mapping):
        raise DoubleError(
            f"the {NAME} of the double of {member.id} are {told!r}: give a dict of names and values"
        )
    known = _known(mission, member)
    for name, value in told.items():
        if name not in known:
            hint = did_you_mean(str(name), known) or f"it has {listed(known) or 'none'}"
            raise DoubleError(
                f"the double of {member.id} says {name!r}, and {member.type} has no such live attribute in "
                f"this mission: {hint}"
            )
        if not _fits(value, known[name]):
            raise DoubleError(
                f"the double of {member.id} says {name} = {value!r}, which is no {known[name]}: give one"
            )
    return {name: Sample(value, now, now) for name, value in told.items()}


def _known(mission: Mission, member: Member) -> dict[str, AttributeType]:
    """The live attributes of a resource, and of which type they are."""
    registry = mission.registry
    if registry is None or member.type not in registry.providers:
        return {}
    deployed = next(agent for agent in mission.team.deployed if agent.id == member.id)
    return {name: registry.attributes[name].type for name in live_attributes(registry, deployed)}


def _fits(value: object, wanted: AttributeType) -> bool:
    if isinstance(value, bool):
        return wanted == "boolean"
    if isinstance(value, str):
        return wanted == "text"
    if isinstance(value, int):
        return wanted in ("int", "real")
    return isinstance(value, float) and wanted == "real" and math.isfinite(value)
