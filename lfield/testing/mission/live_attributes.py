"""Live attributes of a resource with a double.

A double has no devices with telemetry. It provides live attributes in `live_attributes`, a dict of names and
values, or a method that returns one at each query; in the units of the registry (chapter IV). Missing
attributes are unknown.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from msgspec.structs import replace

from lfield.capability.directory.agent_profile import live_attributes
from lfield.capability.directory.directory_delta import AgentCondition, AttributeSample
from lfield.capability.model import AttributeType
from lfield.capability.offer import Provenance
from lfield.errors import DoubleError
from lfield.mission.mission import Mission
from lfield.simulate.host_fleet import HostRun
from lfield.text.suggestions import did_you_mean, listed
from lfield.vm.agent import TeamMember

#: The attribute of a double.
NAME = "live_attributes"


def has_live_attributes(double: object) -> bool:
    """Whether a double provides live attributes; a mock, which creates attributes on access, does not."""
    return NAME in dir(double)


def check(mission: Mission, member: TeamMember, double: object) -> None:
    """Raises DoubleError for a dict with unknown attributes; a method is checked later."""
    provided = getattr(double, NAME) if has_live_attributes(double) else {}
    if not callable(provided):
        _samples(mission, member, provided, 0.0)


def attach(
    mission: Mission, member: TeamMember, run: HostRun, double: object, failures: list[BaseException]
) -> None:
    """Connects a double's attributes to one incarnation of its host; exceptions go to `failures`."""
    directory, clock = run.core.directory.directory, run.host.clock

    def replaced(condition: AgentCondition) -> AgentCondition:
        bound = {name: s for name, s in condition.samples.items() if s.of == "stated"}
        samples = {**current_samples(), **bound}
        silent = f"its double does not provide it ({member.id})"
        unknown = {name: silent for name in condition.unknown if name not in samples}
        return replace(condition, samples=samples, unknown=unknown)

    def current_samples() -> dict[str, AttributeSample]:
        try:
            provided = getattr(double, NAME)
            return _samples(
                mission, member, provided() if callable(provided) else provided, clock.monotonic()
            )
        except Exception as error:  # the double belongs to the test: report there, not to the host
            failures.append(error)
            return {}

    directory.replace_own(member.id, replaced)


def _samples(mission: Mission, member: TeamMember, values: object, now: float) -> dict[str, AttributeSample]:
    """The present samples. Raises DoubleError."""
    if not isinstance(values, Mapping):
        raise DoubleError(
            f"the {NAME} of the double of {member.id} are {values!r}: give a dict of names and values"
        )
    attributes = _known(mission, member)
    for name, value in values.items():
        if name not in attributes:
            hint = did_you_mean(str(name), attributes) or f"it has {listed(attributes) or 'none'}"
            raise DoubleError(
                f"the double of {member.id} provides {name!r}, but {member.type} has no such live attribute "
                f"in this mission: {hint}"
            )
        if not _fits(value, attributes[name]):
            raise DoubleError(
                f"the double of {member.id} provides {name} = {value!r}, which is not a value of type "
                f"{attributes[name]}"
            )
    return {
        name: AttributeSample(value, now, now, of=_provenance(mission, name))
        for name, value in values.items()
    }


def _provenance(mission: Mission, name: str) -> Provenance:
    """The provenance of an attribute: measured if it is live, else declared."""
    return "measured" if mission.registry is not None and mission.registry.attributes[name].live else "told"


def _known(mission: Mission, member: TeamMember) -> dict[str, AttributeType]:
    """The live attributes of a resource, with their types."""
    registry = mission.registry
    if registry is None or member.type not in registry.providers:
        return {}
    deployed = next(agent for agent in mission.team.deployed if agent.id == member.id)
    return {name: registry.attributes[name].type for name in live_attributes(registry, deployed)}


def _fits(value: object, type: AttributeType) -> bool:
    if isinstance(value, bool):
        return type == "boolean"
    if isinstance(value, str):
        return type == "text"
    if isinstance(value, int):
        return type in ("int", "real")
    return isinstance(value, float) and type == "real" and math.isfinite(value)
