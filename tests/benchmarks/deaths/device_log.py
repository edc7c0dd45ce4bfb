"""The log that a device writes, and the verdict on a death: when the device was safe, and when it stood."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from deaths.devices import Device, Facts


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
    """The verdict on a death at time `death`, from the changes since `start`."""
    before = {**start, **{change.name: change.value for change in changes if change.at <= death}}
    now, own = dict(before), False
    safe = death if device.safe(before, before) else None
    rest = safe if device.at_rest(before) else None
    for at, together in groupby((c for c in changes if c.at > death), key=attrgetter("at")):
        now.update({change.name: change.value for change in together})
        was, safe = safe, (safe or at) if device.safe(before, now) else None
        rest = (rest or at) if safe and device.at_rest(now) else None
        if safe and not was:
            own = device.own(now)
    return Verdict(safe and safe - death, rest and rest - death, own and safe is not None)
