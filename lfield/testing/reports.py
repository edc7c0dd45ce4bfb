"""What a driver reports, kept: the guard's end of a driver for tests that need no guard."""

from __future__ import annotations

from collections.abc import Mapping

from lfield.manifest import DeviceValue


class KeptReports:
    """A `lfield.driver.Reports` that remembers what it was told by some devices."""

    def __init__(self, *devices: str) -> None:
        #: The newest value of every quantity, by the names of the devices.
        self.reported: dict[str, dict[str, DeviceValue]] = {device: {} for device in devices}
        #: One sentence each, for the log of the host.
        self.notes: list[str] = []
        #: Why a device must be made safe, one sentence each.
        self.breaches: list[str] = []
        #: Why a device must be inspected before it moves again, one sentence each.
        self.lock_outs: list[str] = []
        #: What broke where nobody waits for it.
        self.crashes: list[str] = []

    @property
    def values(self) -> dict[str, DeviceValue]:
        """What the first device has reported."""
        return next(iter(self.reported.values()), {})

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """New values of telemetry quantities."""
        self.reported.setdefault(device, {}).update(values)

    def heard(self, device: str) -> None:
        """A sign of life; nobody has asked for it."""

    def note(self, device: str, text: str) -> None:
        """One sentence."""
        self.notes.append(text)

    def breach(self, device: str, reason: str) -> None:
        """Beyond a limit."""
        self.breaches.append(reason)

    def lock_out(self, device: str, reason: str) -> None:
        """It must be inspected."""
        self.lock_outs.append(reason)

    def crashed(self, reason: str | BaseException) -> None:
        """Something has broken."""
        self.crashes.append(reason if isinstance(reason, str) else repr(reason))
