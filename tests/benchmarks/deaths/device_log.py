"""What a device wrote into its own log, and what that says of a death: when it was safe, when it stood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from deaths.devices import Device, Facts

#: Lines that are no farther apart were written by one look of the device at itself, in seconds.
ONE_LOOK = 0.002


class Change(NamedTuple):
    """`name` became `value` at `at`, on CLOCK_MONOTONIC in seconds."""

    at: float
    name: str
    value: str

    def __str__(self) -> str:
        return f"{self.name}={self.value}"


@dataclass(frozen=True)
class Verdict:
    """Seconds from the death to the safe state, and until the device stood; None for what has not come yet.

    Both are of the last time that it became so: what was safe and is not any more is not safe. `own` is
    whether the device's own watchdog had acted when it became safe.
    """

    safe: float | None = None
    rest: float | None = None
    own: bool = False

    def seconds(self, what: str) -> float | None:
        """To what is called `safe` or `at rest`."""
        return self.safe if what == "safe" else self.rest


class DeviceLog:
    """The log of one device, read as it grows."""

    def __init__(self, path: Path) -> None:
        self._path, self._place = path, 0
        #: What is so now, and the changes since `forget`.
        self.now: dict[str, str] = {}
        self.changes: list[Change] = []

    def read(self) -> None:
        """Take in what was written since."""
        with self._path.open("rb") as file:
            file.seek(self._place)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._place += len(whole)
        for line in whole.decode().splitlines():
            at, _, told = line.split(" ", 2)
            change = Change(float(at), *told.split("=", 1))
            self.changes.append(change)
            self.now[change.name] = change.value

    def forget(self) -> Facts:
        """Begin anew: what is so now, which the changes from here on are changes of."""
        self.read()
        self.changes.clear()
        return dict(self.now)


def judge(device: Device, start: Facts, changes: Sequence[Change], death: float) -> Verdict:
    """What the changes since `start` say of a death at a time."""
    now = dict(start)
    for change in changes:
        if change.at <= death:
            now[change.name] = change.value
    before = dict(now)
    safe = death if device.safe(before, before) else None
    rest = safe if device.at_rest(before) else None
    for change in changes:
        if change.at > death:
            now[change.name] = change.value
            safe = (safe or change.at) if device.safe(before, now) else None
            rest = (rest or change.at) if safe and device.at_rest(now) else None
    if safe is None:
        return Verdict()
    return Verdict(safe - death, rest and rest - death, _own(device, start, changes, safe))


def _own(device: Device, start: Facts, changes: Sequence[Change], safe: float) -> bool:
    now = dict(start)
    now.update({change.name: change.value for change in changes if change.at <= safe + ONE_LOOK})
    return device.own(now)
