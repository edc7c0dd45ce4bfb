"""The telemetry of the devices of one guard, as its last snapshots have told it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import cast

from lfield.clock import Clock
from lfield.driver.binding import DeviceBinding
from lfield.driver.contract import AGE
from lfield.driver.known import KnownDriver
from lfield.driver.values import conform
from lfield.errors import DeviceError, WireError
from lfield.guard.messages import Snapshot
from lfield.manifest import DeviceValue, Observation, Quantity
from lfield.text.values import telemetry_in_words
from lfield.vm.contract import Reading
from lfield.vm.memory.values import word_of

#: A device that was heard before is lost after so many seconds of silence, at least.
LOST_AFTER = 3.0
#: So many quantities are told in a line of the log that says something else first.
IN_A_LINE = 4


class Snapshots:
    """The newest observation of each quantity; what is too old is refused, never given."""

    def __init__(self, driver: KnownDriver, devices: Iterable[DeviceBinding], clock: Clock) -> None:
        self._clock = clock
        self._devices = {device.name: device for device in devices}
        self._quantities = {
            (device.name, quantity.name): quantity
            for device in self._devices.values()
            for quantity in driver.manifests[device.type].device.telemetry
        }
        self._patience = {
            device.name: _patience(driver.manifests[device.type].device.telemetry)
            for device in self._devices.values()
        }
        self._seen: dict[tuple[str, str], Observation] = {}
        self._readings: dict[tuple[str, str], Reading] = {}
        #: When each device was last heard, by its name; nothing for one that never was.
        self.heard: dict[str, float] = {}
        #: The devices that somebody else has, such as a pilot.
        self.taken: set[str] = set()

    def take(self, snapshot: Snapshot) -> None:
        """Take a snapshot in, and keep the readings up to date. Raises WireError for what none can have."""
        if snapshot.device not in self._devices:
            raise WireError(f"telemetry of '{snapshot.device}', which it does not guard")
        self.heard[snapshot.device] = snapshot.heard
        (self.taken.add if snapshot.taken else self.taken.discard)(snapshot.device)
        for name, seen in snapshot.values.items():
            key = snapshot.device, name
            self._seen[key] = Observation(self._conform(key, seen.value), seen.when)
            if key in self._readings:
                self._update(key)

    def _conform(self, key: tuple[str, str], value: DeviceValue) -> DeviceValue:
        """A value as its quantity has it. Raises WireError."""
        if key not in self._quantities:
            raise WireError(f"{key[0]} has no {key[1]}")
        try:
            return conform(value, self._quantities[key].type)
        except ValueError as error:
            raise WireError(f"{key[1]} of {key[0]}: {error}") from None

    def query(self, device: str, quantity: str) -> DeviceValue:
        """The last value of a telemetry quantity. Raises DeviceError when there is none or it is too old."""
        binding, now = self._devices[device], self._clock.monotonic()
        if quantity == AGE.name:
            if device not in self.heard:
                raise DeviceError(binding.field, "has not been heard yet", kind="DeviceTimeoutException")
            return now - self.heard[device]
        seen = self._seen.get((device, quantity))
        if seen is None:
            raise DeviceError(binding.field, f"has not reported {quantity}", kind="DeviceTimeoutException")
        age, longest = now - seen.when, self._quantities[device, quantity].max_age
        if age > longest:
            reason = f"the last {quantity} is {age:.1f} s old (at most {longest:g} s)"
            raise DeviceError(binding.field, reason, kind="DeviceTimeoutException")
        return seen.value

    def last(self, device: str, quantity: str) -> Observation | None:
        """The last value of a telemetry quantity, however old; None for none yet."""
        if quantity == AGE.name and device in self.heard:
            now = self._clock.monotonic()
            return Observation(now - self.heard[device], now)
        return self._seen.get((device, quantity))

    def lost_since(self, device: str) -> float | None:
        """Since when a device has not been heard, if that is longer than it should take; None if not.

        It should take as long as its quickest quantity may be old, and LOST_AFTER at least. A device that has
        never said anything is not lost: not every one has something to say.
        """
        heard = self.heard.get(device)
        if heard is None or self._clock.monotonic() - heard <= self._patience[device]:
            return None
        return heard

    def reading(self, device: str, quantity: str) -> Reading | None:
        """A reading that every snapshot keeps up to date, None for text, arrays and `age`."""
        declared = self._quantities.get((device, quantity))
        if declared is None or declared.type not in ("boolean", "int", "real"):
            return None
        if (device, quantity) not in self._readings:
            self._readings[device, quantity] = Reading()
            self._update((device, quantity))
        return self._readings[device, quantity]

    def _update(self, key: tuple[str, str]) -> None:
        reading, seen = self._readings[key], self._seen[key]
        value = seen.value
        reading.word = word_of(value) if isinstance(value, float) else int(cast("int", value))
        reading.until = seen.when + self._quantities[key].max_age

    def in_words(self, device: str) -> str:
        """What was last known of a device: `last heard 0.3 s ago: armed yes, mode LAND`."""
        if device not in self.heard:
            return "it was never heard"
        age = self._clock.monotonic() - self.heard[device]
        words = telemetry_in_words(self.telemetry[device], IN_A_LINE)
        return f"last heard {age:.1f} s ago{f': {words}' if words else ''}"

    @property
    def telemetry(self) -> dict[str, dict[str, DeviceValue]]:
        """The last values known, by device and quantity in the order of the manifest, however old."""
        shown: dict[str, dict[str, DeviceValue]] = {name: {} for name in self._devices}
        for device, quantity in self._quantities:
            if (device, quantity) in self._seen:
                shown[device][quantity] = self._seen[device, quantity].value
        return shown


def _patience(quantities: Iterable[Quantity]) -> float:
    """For how many seconds a device with these quantities may be silent."""
    return max(LOST_AFTER, min((quantity.max_age for quantity in quantities), default=LOST_AFTER))
