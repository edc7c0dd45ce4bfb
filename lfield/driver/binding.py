"""One bound device: what `mission.devices.yaml` says about one field of one agent."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from lfield.driver.frame import Placement

#: The endpoint of a device whose fake has not been started yet begins so; what follows names the bus.
SIMULATED = "sim:"

#: A shorter time without a sign of a coordinator says nothing, in seconds: a sign may be as long on its way.
LEAST_AFTER = 5.0

#: A value of an option in a devices file.
OptionValue = bool | int | float | str | list[int | str]


class WithoutPolicy(msgspec.Struct, frozen=True):
    """After so many seconds without a sign of a coordinator that used a device: a safe state of its type."""

    after: float
    do: str


class DeviceBinding(msgspec.Struct, frozen=True, kw_only=True):
    """A device with its driver, place and limits; travels to the guard as it is.

    `ttl` is the time-to-live of a setpoint in seconds, and how long a command may take to begin; within
    `rest_within` seconds of a stop the device is at rest, or its guard gives up and says so.
    `without_policy` says what becomes of it when no coordinator that used it is heard of any more, None
    for nothing. `limits` are in the SI units that the manifest names, `options` are the driver's own
    (`system`, `kind`). An absent limit does not limit. `waivers` name the protections that whoever wrote
    the binding has knowingly given up, `reasons` why, by their names. `frame` says where its agent is in
    the team's frame, None where nobody has said that. `sim` are faults and conditions of its fake,
    `NAME=VALUE`, for simulated missions. `type` is the device type in L. A pure sensor has no
    `safe_state`, and nothing of its `ttl` and `rest_within` applies.
    """

    agent: str
    field: str
    type: str
    driver: str
    endpoint: str
    safe_state: str = ""
    ttl: float = 0.5
    rest_within: float = 120.0
    limits: dict[str, float] = {}
    options: dict[str, OptionValue] = {}
    waivers: list[str] = []
    reasons: dict[str, str] = {}
    without_policy: WithoutPolicy | None = None
    frame: Placement | None = None
    sim: list[str] = []

    @property
    def name(self) -> str:
        """`alpha.fc`: unique in a mission."""
        return f"{self.agent}.{self.field}"

    @property
    def bus(self) -> tuple[str, str]:
        """Devices with the same bus share one guard."""
        return self.driver, self.endpoint

    @property
    def is_sensor(self) -> bool:
        """Whether it only senses: nothing that it does could be made safe."""
        return not self.safe_state

    def waives(self, protection: str) -> bool:
        """Whether the binding gives this protection up, by its name."""
        return protection in self.waivers

    def option(self, name: str) -> Any:
        """An option of the manifest; always present, since the loader fills in defaults."""
        return self.options[name]


def by_bus(devices: Iterable[DeviceBinding]) -> dict[tuple[str, str], list[DeviceBinding]]:
    """The devices of each bus, in their order."""
    buses: dict[tuple[str, str], list[DeviceBinding]] = {}
    for device in devices:
        buses.setdefault(device.bus, []).append(device)
    return buses


def longest_rest(devices: Iterable[DeviceBinding]) -> float:
    """How long the slowest of these devices may take to come to rest, in seconds; 0 without any.

    A sensor is at rest at once.
    """
    return max((device.rest_within for device in devices if not device.is_sensor), default=0.0)
