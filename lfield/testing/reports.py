"""What a driver reports, kept: the guard's end of a driver for tests that need no guard."""

from __future__ import annotations

from collections.abc import Mapping

from lfield.manifest import DeviceValue


class KeptReports:
    """A `lfield.driver.Reports` that remembers: the newest values, all notes, all crashes."""

    def __init__(self) -> None:
        self.values: dict[str, DeviceValue] = {}
        self.notes: list[str] = []
        self.crashes: list[str] = []

    def publish(self, device: str, values: Mapping[str, DeviceValue]) -> None:
        """New values of telemetry quantities."""
        self.values.update(values)

    def heard(self, device: str) -> None:
        """A sign of life; nobody has asked for it."""

    def note(self, device: str, text: str) -> None:
        """One sentence."""
        self.notes.append(text)

    def crashed(self, reason: str) -> None:
        """Something in the driver has broken."""
        self.crashes.append(reason)
