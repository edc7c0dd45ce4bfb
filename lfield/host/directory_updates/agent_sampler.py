"""The present condition of this host's agents: attributes from telemetry, portals and bindings, and reasons
why an agent cannot be called.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Protocol

from lfield.capability.directory.directory_delta import (
    UNCHANGED,
    AgentCondition,
    AttributeSample,
    Unavailability,
)
from lfield.capability.model import Attribute, AttributeType, LiveAttribute, Value
from lfield.clock import Clock
from lfield.manifest import DeviceValue, Observation
from lfield.mission.bindings import StatedValue
from lfield.vm.agent import Agent
from lfield.wire.fields import MAX_LABEL, truncate

#: Numbers of at least this value, and NaN, are not valid attribute values.
_LARGEST = 2.0**63


class DeviceReadings(Protocol):
    """The devices of a host, by name, from the telemetry that the host has."""

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old; None if there is none yet."""

    def unavailability(self, device: str) -> Unavailability | None:
        """The reason why a device cannot be called now; None when it can."""


class PortalReadings(Protocol):
    """Polled portals of the resources of a host."""

    def last(self, agent: str, portal: str) -> Observation | str | None:
        """The last result of a portal, or the reason for a failure; None for no answer yet."""


class AgentSampler:
    """`agents` are those of the machine, `fields` the names of the device fields of each agent, `bound` the
    attributes stated in its binding.
    """

    def __init__(
        self,
        attributes: Mapping[str, Attribute],
        agents: Mapping[str, Agent],
        fields: Mapping[str, Iterable[str]],
        devices: DeviceReadings,
        portals: PortalReadings,
        clock: Clock,
        bound: Mapping[str, Mapping[str, StatedValue]] = MappingProxyType({}),
    ) -> None:
        self._attributes, self._agents, self._fields = attributes, agents, fields
        self._devices, self._portals, self._clock = devices, portals, clock
        self._bound = {agent: self._stated(values) for agent, values in bound.items()}

    def _stated(self, values: Mapping[str, StatedValue]) -> dict[str, AttributeSample]:
        now = self._clock.monotonic()
        return {
            name: AttributeSample(
                frozenset(value) if isinstance(value, tuple) else value, now, now, of="stated"
            )
            for name, value in values.items()
            if name in self._attributes
        }

    def condition(self, agent: str, live: Mapping[str, LiveAttribute]) -> AgentCondition:
        """The condition of an agent of this host; `live` are its measured attributes.

        Values stated by the binding take precedence.
        """
        bound, unavailability = self._bound.get(agent, {}), self.unavailability(agent)
        if not live and not bound and unavailability is None:
            return UNCHANGED
        found = {name: self._sample(agent, live[name]) for name in live if name not in bound}
        samples = {name: sample for name, sample in found.items() if isinstance(sample, AttributeSample)}
        unknown = {name: reason for name, reason in found.items() if isinstance(reason, str)}
        return AgentCondition(unavailability, {**samples, **bound}, unknown)

    def unavailability(self, agent: str) -> Unavailability | None:
        """The reason why an agent of this host cannot be called now; None when it can."""
        running = self._agents.get(agent)
        if running is None:
            return Unavailability("its host does not run it")
        if running.ended:
            return Unavailability(f"died of {running.report.splitlines()[0]}")
        found = (self._devices.unavailability(f"{agent}.{field}") for field in self._fields.get(agent, ()))
        return next((unavailability for unavailability in found if unavailability), None)

    def _sample(self, agent: str, live: LiveAttribute) -> AttributeSample | str:
        """The value of a live attribute, or the reason why there is none."""
        source, quantity = (live.device, live.quantity) if live.device else (agent, f"{live.portal}()")
        observation = self._observation(agent, live)
        if isinstance(observation, str):
            return observation
        if observation is None:
            return f"{source} has not reported {quantity}"
        value = observation.value
        if live.index is not None:
            if not isinstance(value, list | tuple) or live.index >= len(value):
                return f"{source} reports no element {live.index} of {quantity}"
            value = value[live.index]
        attribute, now = self._attributes[live.attribute], self._clock.monotonic()
        fitting = _converted(value, live, attribute.type)
        if fitting is None:
            return f"{source} reports {quantity} as {value}"
        return (
            AttributeSample(fitting, observation.when, now)
            if attribute.live
            else AttributeSample(fitting, now, now, of="told")
        )

    def _observation(self, agent: str, live: LiveAttribute) -> Observation | str | None:
        if live.device:
            return self._devices.last(f"{agent}.{live.device}", live.quantity)
        return self._portals.last(agent, live.portal)


def _converted(value: DeviceValue, live: LiveAttribute, target: AttributeType) -> Value | None:
    """Telemetry as a value of an attribute in its unit; None if it is invalid, such as NaN."""
    if isinstance(value, bool):
        return value if target == "boolean" else None
    if isinstance(value, str):
        return truncate(value, MAX_LABEL) if target == "text" else None
    if not isinstance(value, int | float) or target not in ("int", "real"):
        return None
    number = value * live.factor + live.offset
    if not abs(number) < _LARGEST:
        return None
    return round(number) if target == "int" else float(number)
