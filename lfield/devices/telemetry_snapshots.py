"""Telemetry of the devices of one guard, from its last snapshots."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import AGE
from lfield.driver.driver_index import DriverInfo
from lfield.driver.value_types import conform
from lfield.errors import DeviceError, WireError
from lfield.guard.messages import TelemetrySnapshot
from lfield.manifest import DeviceValue, Observation, Quantity
from lfield.text.value_text import telemetry_text
from lfield.vm.engine_interface import Reading
from lfield.vm.memory.word_codec import bits_of_real

#: The minimum seconds of silence after which a device with earlier messages counts as lost.
SILENCE_LIMIT = 3.0
#: Quantities in the description of a device's last condition.
MAX_DESCRIBED = 4


class Snapshots:
    """The newest observation of each quantity; a value that is too old is refused."""

    def __init__(self, driver: DriverInfo, devices: Iterable[DeviceBinding], clock: Clock) -> None:
        self._clock = clock
        self._devices = {device.name: device for device in devices}
        self._quantities = {
            (device.name, quantity.name): quantity
            for device in self._devices.values()
            for quantity in driver.manifests[device.type].device.telemetry
        }
        self._silence_limit = {
            device.name: _silence_limit(driver.manifests[device.type].device.telemetry)
            for device in self._devices.values()
        }
        self._observations: dict[tuple[str, str], Observation] = {}
        self._readings: dict[tuple[str, str], Reading] = {}
        #: The time of the last message of each device, by name; absent before the first one.
        self.last_contact: dict[str, float] = {}
        #: Devices under foreign control, such as a pilot's.
        self.foreign_controlled: set[str] = set()

    def on_snapshot(self, snapshot: TelemetrySnapshot) -> None:
        """Stores a snapshot and updates readings. Raises WireError for an unknown device or a wrong type."""
        if snapshot.device not in self._devices:
            raise WireError(f"telemetry of '{snapshot.device}', which it does not guard")
        self.last_contact[snapshot.device] = snapshot.last_contact
        if snapshot.is_foreign_controlled:
            self.foreign_controlled.add(snapshot.device)
        else:
            self.foreign_controlled.discard(snapshot.device)
        for name, observation in snapshot.values.items():
            key = snapshot.device, name
            self._observations[key] = Observation(self._conform(key, observation.value), observation.when)
            if key in self._readings:
                self._update(key)

    def _conform(self, key: tuple[str, str], value: DeviceValue) -> DeviceValue:
        """The value with the type of its quantity. Raises WireError."""
        if key not in self._quantities:
            raise WireError(f"{key[0]} has no {key[1]}")
        try:
            return conform(value, self._quantities[key].type)
        except ValueError as error:
            raise WireError(f"{key[1]} of {key[0]}: {error}") from None

    def query(self, device: str, quantity: str) -> DeviceValue:
        """The last value of a telemetry quantity. Raises DeviceError without a value, or if it is too old."""
        binding, now = self._devices[device], self._clock.monotonic()
        if quantity == AGE.name:
            if device not in self.last_contact:
                raise DeviceError(binding.field, "has not sent anything yet", kind="DeviceTimeoutException")
            return now - self.last_contact[device]
        observation = self._observations.get((device, quantity))
        if observation is None:
            raise DeviceError(binding.field, f"has not reported {quantity}", kind="DeviceTimeoutException")
        age, longest = now - observation.when, self._quantities[device, quantity].max_age
        if age > longest:
            reason = f"the last {quantity} is {age:.1f} s old (at most {longest:g} s)"
            raise DeviceError(binding.field, reason, kind="DeviceTimeoutException")
        return observation.value

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity of any age; None before the first."""
        if quantity == AGE.name and device in self.last_contact:
            now = self._clock.monotonic()
            return Observation(now - self.last_contact[device], now)
        return self._observations.get((device, quantity))

    def silent_since(self, device: str) -> float | None:
        """The time since when a device is silent, if this silence is too long; otherwise None.

        The limit is the shortest `max_age` of its quantities, at least SILENCE_LIMIT. A device that has never
        sent a message is not lost: some devices never send any.
        """
        last = self.last_contact.get(device)
        if last is None or self._clock.monotonic() - last <= self._silence_limit[device]:
            return None
        return last

    def reading(self, device: str, quantity: str) -> Reading | None:
        """A reading that every snapshot updates, None for text, arrays and `age`."""
        declared = self._quantities.get((device, quantity))
        if declared is None or declared.type not in ("boolean", "int", "real"):
            return None
        if (device, quantity) not in self._readings:
            self._readings[device, quantity] = Reading()
            self._update((device, quantity))
        return self._readings[device, quantity]

    def _update(self, key: tuple[str, str]) -> None:
        reading, observation = self._readings[key], self._observations[key]
        value = observation.value
        bits = bits_of_real(value) if isinstance(value, float) else int(cast("int", value))
        reading.update(bits, observation.when + self._quantities[key].max_age)

    def describe(self, device: str) -> str:
        """The last known condition of a device: `last contact 0.3 s ago: armed yes, mode LAND`."""
        if device not in self.last_contact:
            return "it has sent no message"
        age = self._clock.monotonic() - self.last_contact[device]
        values = telemetry_text(self.telemetry[device], MAX_DESCRIBED)
        return f"last contact {age:.1f} s ago{f': {values}' if values else ''}"

    @property
    def telemetry(self) -> dict[str, dict[str, DeviceValue]]:
        """The last known values, by device and quantity in the order of the manifest, of any age."""
        values_by_device: dict[str, dict[str, DeviceValue]] = {name: {} for name in self._devices}
        for device, quantity in self._quantities:
            if (device, quantity) in self._observations:
                values_by_device[device][quantity] = self._observations[device, quantity].value
        return values_by_device


def _silence_limit(quantities: Iterable[Quantity]) -> float:
    """The seconds for which a device with these quantities may be silent."""
    return max(SILENCE_LIMIT, min((quantity.max_age for quantity in quantities), default=SILENCE_LIMIT))
