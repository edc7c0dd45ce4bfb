"""Where the devices of a team were, by their fakes' own truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from lfield.testing.mission.fakes import FakeDevice

#: Seconds between two points of a track.
EVERY = 0.1


class Point(NamedTuple):
    """A place at a time: seconds; metres north, east and up of where the team's fakes are switched on."""

    at: float
    north: float
    east: float
    up: float


class Tracks:
    """The tracks of all devices that tell where they are. `later` calls after so many seconds."""

    def __init__(
        self,
        devices: Mapping[str, FakeDevice],
        now: Callable[[], float],
        later: Callable[[float, Callable[[], None]], None],
    ) -> None:
        self._devices, self._now, self._later = devices, now, later
        self.record: dict[str, list[Point]] = {}
        self._look()

    def _look(self) -> None:
        for name, device in self._devices.items():
            if (place := device.place) is not None:
                self.record.setdefault(name, []).append(Point(self._now(), *place))
        self._later(EVERY, self._look)
