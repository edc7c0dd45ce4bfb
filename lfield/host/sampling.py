"""How the agents of this host are now: their live attributes, and what keeps them from being called."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol

from lfield.capability.directory.news import SILENCE, Condition, Sample, Scalar, Trouble
from lfield.capability.model import Attribute, AttributeType, Live
from lfield.clock import Clock
from lfield.manifest import DeviceValue, Observation
from lfield.vm.agent import Agent

#: Numbers from here on, and NaN, are no values.
_LARGEST = 2.0**63


class Devices(Protocol):
    """The devices of a host, by name, as the host knows them without asking."""

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old; None for none yet."""

    def trouble(self, device: str) -> Trouble | None:
        """Why a device cannot be called now; None when it can."""


class Sampler:
    """`agents` are those of the machine, `fields` the names of each one's device fields."""

    def __init__(
        self,
        attributes: Mapping[str, Attribute],
        agents: Mapping[str, Agent],
        fields: Mapping[str, Iterable[str]],
        devices: Devices,
        clock: Clock,
    ) -> None:
        self._attributes, self._agents, self._fields = attributes, agents, fields
        self._devices, self._clock = devices, clock

    def condition(self, agent: str, live: Mapping[str, Live]) -> Condition:
        """How an agent of this host is now; `live` are its live attributes."""
        trouble = self._trouble(agent)
        if not live and trouble is None:
            return SILENCE
        found = {name: self._sample(agent, source) for name, source in live.items()}
        samples = {name: sample for name, sample in found.items() if isinstance(sample, Sample)}
        unknown = {name: why for name, why in found.items() if isinstance(why, str)}
        return Condition(trouble, samples, unknown)

    def _trouble(self, agent: str) -> Trouble | None:
        running = self._agents.get(agent)
        if running is None:
            return Trouble("its host does not run it")
        if running.ended:
            return Trouble(f"died of {running.report.splitlines()[0]}")
        found = (self._devices.trouble(f"{agent}.{field}") for field in self._fields[agent])
        return next((trouble for trouble in found if trouble), None)

    def _sample(self, agent: str, live: Live) -> Sample | str:
        """The value of a live attribute, or why there is none."""
        seen = self._devices.last(f"{agent}.{live.device}", live.quantity)
        if seen is None:
            return f"{live.device} has not reported {live.quantity}"
        value = seen.value
        if live.index is not None:
            if not isinstance(value, list | tuple) or live.index >= len(value):
                return f"{live.device} reports no element {live.index} of {live.quantity}"
            value = value[live.index]
        fitting = _fitting(value, live, self._attributes[live.attribute].type)
        if fitting is None:
            return f"{live.device} reports {live.quantity} as {value}"
        return Sample(fitting, seen.when, self._clock.monotonic())


def _fitting(value: DeviceValue, live: Live, wanted: AttributeType) -> Scalar | None:
    """Telemetry as a value of an attribute in its unit; None when it is no such value, as NaN."""
    if isinstance(value, bool):
        return value if wanted == "boolean" else None
    if isinstance(value, str):
        return value if wanted == "text" else None
    if not isinstance(value, int | float) or wanted not in ("int", "real"):
        return None
    number = value * live.factor + live.offset
    if not abs(number) < _LARGEST:
        return None
    return round(number) if wanted == "int" else float(number)
