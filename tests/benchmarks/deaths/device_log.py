"""The log of a device, and the verdict on a process failure: when the device was safe and at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from deaths.devices import Device, Facts


class Change(NamedTuple):
    """A change of the quantity `name` to `value` at time `at` (CLOCK_MONOTONIC, s)."""

    at: float
    name: str
    value: str

    def __str__(self) -> str:
        return f"{self.name}={self.value}"


@dataclass(frozen=True)
class Verdict:
    """Seconds from the failure to the safe state and to rest; None for a state that is not reached.

    Only the last change counts: a device that has left its safe state is not safe. `own` is set if the
    device's own watchdog had acted when the device became safe.
    """

    safe: float | None = None
    rest: float | None = None
    own: bool = False

    def seconds(self, what: str) -> float | None:
        """Seconds to the state named `safe` or `at rest`."""
        return self.safe if what == "safe" else self.rest


class DeviceLog:
    """The log of one device, read as it grows."""

    def __init__(self, path: Path) -> None:
        self._path, self._place = path, 0
        #: The current values, and the changes since `mark_start`.
        self.now: dict[str, str] = {}
        self.changes: list[Change] = []

    def read(self) -> None:
        """Read the new lines."""
        with self._path.open("rb") as file:
            file.seek(self._place)
            data = file.read()
        complete_lines = data[: data.rfind(b"\n") + 1]
        self._place += len(complete_lines)
        for line in complete_lines.decode().splitlines():
            at, _, assignment = line.split(" ", 2)
            change = Change(float(at), *assignment.split("=", 1))
            self.changes.append(change)
            self.now[change.name] = change.value

    def mark_start(self) -> Facts:
        """Discard the changes so far; returns the current values, to which later changes apply."""
        self.read()
        self.changes.clear()
        return dict(self.now)


def judge(device: Device, start: Facts, changes: Sequence[Change], death: float) -> Verdict:
    """The verdict on a failure at time `death`, from the values at `start` and the changes since."""
    before = {**start, **{change.name: change.value for change in changes if change.at <= death}}
    now, own = dict(before), False
    safe = death if device.safe(before, before) else None
    rest = safe if device.at_rest(before) else None
    for at, simultaneous in groupby((c for c in changes if c.at > death), key=attrgetter("at")):
        now.update({change.name: change.value for change in simultaneous})
        was, safe = safe, (safe or at) if device.safe(before, now) else None
        rest = (rest or at) if safe and device.at_rest(now) else None
        if safe and not was:
            own = device.own(now)
    return Verdict(safe and safe - death, rest and rest - death, own and safe is not None)
