"""A bound device: the entry of one field of one agent in `mission.devices.yaml`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from lfield.driver.frame import Placement

#: Prefix of the endpoint of a device whose fake has not been started yet; the rest names the bus.
SIMULATED = "sim:"

#: Shortest allowed time-out without contact to a coordinator, in seconds: a heartbeat may take as long to
#: arrive.
MIN_ORPHAN_TIMEOUT = 5.0

#: A value of an option in a devices file.
OptionValue = bool | int | float | str | list[int | float | str]


class OrphanPolicy(msgspec.Struct, frozen=True):
    """Brings a device into a safe state when no coordinator that used it has been reachable for `after`
    seconds.
    """

    after: float
    do: str


class DeviceBinding(msgspec.Struct, frozen=True, kw_only=True):
    """A device with its driver, endpoint and limits; sent to the guard unchanged.

    `ttl` is the time-to-live of a setpoint in seconds, and the longest time before a command starts. A
    stopped device must be at rest within `rest_within` seconds; otherwise the guard stops waiting and reports
    the device. `without_policy` is the reaction when every coordinator that used the device is unreachable
    (None: no reaction). `limits` are in the SI units of the manifest; an absent limit does not apply.
    `options` are specific to the driver (`system`, `kind`). `waivers` are the protections that the binding
    gives up, `reasons` the reason for each. `frame` is the pose of the agent in the team's frame, None if
    unknown. `sim` holds faults and conditions of the simulated device (`NAME=VALUE`) for simulated missions.
    `type` is the device type in L. A pure sensor has no `safe_state`; its `ttl` and `rest_within` are
    ignored.
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
    without_policy: OrphanPolicy | None = None
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
        """Whether the device is a pure sensor, which needs no safe state."""
        return not self.safe_state

    def waives(self, protection: str) -> bool:
        """Whether the binding waives the named protection."""
        return protection in self.waivers

    def option(self, name: str) -> Any:
        """The value of an option of the manifest; the loader fills in defaults, so there is always a
        value.
        """
        return self.options[name]


def by_bus(devices: Iterable[DeviceBinding]) -> dict[tuple[str, str], list[DeviceBinding]]:
    """The devices grouped by bus, in their order."""
    buses: dict[tuple[str, str], list[DeviceBinding]] = {}
    for device in devices:
        buses.setdefault(device.bus, []).append(device)
    return buses


def longest_rest(devices: Iterable[DeviceBinding]) -> float:
    """The longest `rest_within` of these devices in seconds; 0 without actuators."""
    return max((device.rest_within for device in devices if not device.is_sensor), default=0.0)
