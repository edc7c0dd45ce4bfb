"""Records the reports of a driver, for tests without a guard."""

from __future__ import annotations

from collections.abc import Mapping

from lfield.manifest import DeviceValue


class KeptReports:
    """A `lfield.driver.Reports` that records the reports of some devices."""

    def __init__(self, *devices: str) -> None:
        #: The newest value of every quantity, by device name.
        self.reported: dict[str, dict[str, DeviceValue]] = {device: {} for device in devices}
        #: Log lines.
        self.notes: list[str] = []
        #: Reasons to make a device safe.
        self.breaches: list[str] = []
        #: Reasons to inspect a device before it moves again.
        self.lock_outs: list[str] = []
        #: Failures that are not awaited.
        self.crashes: list[str] = []

    @property
    def values(self) -> dict[str, DeviceValue]:
        """The values of the first device."""
        return next(iter(self.reported.values()), {})

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """Stores values of telemetry quantities."""
        self.reported.setdefault(device, {}).update(values)

    def heard(self, device: str) -> None:
        """Has no effect: contact is not recorded."""

    def note(self, device: str, text: str) -> None:
        """Records a log line."""
        self.notes.append(text)

    def breach(self, device: str, reason: str) -> None:
        """Records a breach of a limit."""
        self.breaches.append(reason)

    def lock_out(self, device: str, reason: str) -> None:
        """Records a lock-out."""
        self.lock_outs.append(reason)

    def crashed(self, reason: str | BaseException) -> None:
        """Records a failure."""
        self.crashes.append(reason if isinstance(reason, str) else repr(reason))
