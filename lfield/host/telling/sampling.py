"""How the agents of this host are now: what they tell of themselves, what their bindings state of them, and
what keeps them from being called.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Protocol

from lfield.capability.directory.news import SILENCE, Condition, Sample, Trouble
from lfield.capability.model import Attribute, AttributeType, Live, Value
from lfield.clock import Clock
from lfield.manifest import DeviceValue, Observation
from lfield.mission.bindings import Stated
from lfield.vm.agent import Agent
from lfield.wire.fields import MAX_LABEL, clip

#: Numbers from here on, and NaN, are no values.
_LARGEST = 2.0**63


class Devices(Protocol):
    """The devices of a host, by name, as the host knows them without asking."""

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old; None for none yet."""

    def trouble(self, device: str) -> Trouble | None:
        """Why a device cannot be called now; None when it can."""


class Portals(Protocol):
    """The portals of resources of a host that tell something of them."""

    def last(self, agent: str, portal: str) -> Observation | str | None:
        """What one has given last, or why it gave nothing; None for no answer yet."""


class Sampler:
    """`agents` are those of the machine, `fields` the names of each one's device fields, `bound` what the
    bindings state of each."""

    def __init__(
        self,
        attributes: Mapping[str, Attribute],
        agents: Mapping[str, Agent],
        fields: Mapping[str, Iterable[str]],
        devices: Devices,
        portals: Portals,
        clock: Clock,
        bound: Mapping[str, Mapping[str, Stated]] = MappingProxyType({}),
    ) -> None:
        self._attributes, self._agents, self._fields = attributes, agents, fields
        self._devices, self._portals, self._clock = devices, portals, clock
        self._bound = {agent: self._stated(values) for agent, values in bound.items()}

    def _stated(self, values: Mapping[str, Stated]) -> dict[str, Sample]:
        now = self._clock.monotonic()
        return {
            name: Sample(frozenset(value) if isinstance(value, tuple) else value, now, now, of="stated")
            for name, value in values.items()
            if name in self._attributes
        }

    def condition(self, agent: str, live: Mapping[str, Live]) -> Condition:
        """How an agent of this host is now; `live` are the attributes that it tells itself.

        What its binding states counts before that.
        """
        bound, trouble = self._bound.get(agent, {}), self.trouble(agent)
        if not live and not bound and trouble is None:
            return SILENCE
        found = {name: self._sample(agent, live[name]) for name in live if name not in bound}
        samples = {name: sample for name, sample in found.items() if isinstance(sample, Sample)}
        unknown = {name: why for name, why in found.items() if isinstance(why, str)}
        return Condition(trouble, {**samples, **bound}, unknown)

    def trouble(self, agent: str) -> Trouble | None:
        """Why an agent of this host cannot be called now; None when it can."""
        running = self._agents.get(agent)
        if running is None:
            return Trouble("its host does not run it")
        if running.ended:
            return Trouble(f"died of {running.report.splitlines()[0]}")
        found = (self._devices.trouble(f"{agent}.{field}") for field in self._fields[agent])
        return next((trouble for trouble in found if trouble), None)

    def _sample(self, agent: str, live: Live) -> Sample | str:
        """The value of an attribute that an agent tells, or why there is none."""
        who, what = (live.device, live.quantity) if live.device else (agent, f"{live.portal}()")
        seen = self._seen(agent, live)
        if isinstance(seen, str):
            return seen
        if seen is None:
            return f"{who} has not reported {what}"
        value = seen.value
        if live.index is not None:
            if not isinstance(value, list | tuple) or live.index >= len(value):
                return f"{who} reports no element {live.index} of {what}"
            value = value[live.index]
        attribute, now = self._attributes[live.attribute], self._clock.monotonic()
        fitting = _fitting(value, live, attribute.type)
        if fitting is None:
            return f"{who} reports {what} as {value}"
        return Sample(fitting, seen.when, now) if attribute.live else Sample(fitting, now, now, of="told")

    def _seen(self, agent: str, live: Live) -> Observation | str | None:
        if live.device:
            return self._devices.last(f"{agent}.{live.device}", live.quantity)
        return self._portals.last(agent, live.portal)


def _fitting(value: DeviceValue, live: Live, wanted: AttributeType) -> Value | None:
    """Telemetry as a value of an attribute in its unit; None when it is no such value, as NaN."""
    if isinstance(value, bool):
        return value if wanted == "boolean" else None
    if isinstance(value, str):
        return clip(value, MAX_LABEL) if wanted == "text" else None
    if not isinstance(value, int | float) or wanted not in ("int", "real"):
        return None
    number = value * live.factor + live.offset
    if not abs(number) < _LARGEST:
        return None
    return round(number) if wanted == "int" else float(number)
