"""What is plotted of the last minutes: how vehicles are, and how often coordinators hop. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Literal

from lfield.operator.sight.seen import Curve, VehicleSeen

#: For how long, and how densely, in seconds.
WINDOW, STEP = 600.0, 1.0
#: A host may name as many devices as it likes: so many curves are kept.
MOST_CURVES = 1024

What = Literal["battery", "height", "link", "hops"]


class Curves:
    """A point a second of each, for ten minutes. Times are of our monotonic clock."""

    def __init__(self) -> None:
        self._points: dict[tuple[What, str], deque[tuple[float, float]]] = {}
        self._last: float | None = None

    def add(self, now: float, vehicles: Mapping[str, VehicleSeen], hops: Mapping[str, float]) -> None:
        """How it is now; what comes sooner than a step after the last is left out."""
        if self._last is not None and now < self._last + STEP:
            return
        self._last = now
        for agent, vehicle in vehicles.items():
            for what, value in _values(vehicle):
                self._point(what, agent, now, value)
        for agent, count in hops.items():
            self._point("hops", agent, now, count)

    def _point(self, what: What, of: str, now: float, value: float) -> None:
        points = self._points.get((what, of))
        if points is None:
            if len(self._points) >= MOST_CURVES:
                return
            points = self._points[what, of] = deque()
        points.append((now, value))
        while points[0][0] < now - WINDOW:
            points.popleft()

    def seen(self, now: float) -> tuple[Curve, ...]:
        """All of them; what was last told before the window began is no curve any more."""
        found = []
        for (what, of), points in self._points.items():
            shown = tuple((now - when, value) for when, value in points if when >= now - WINDOW)
            if shown:
                found.append(Curve(what, of, shown))
        return tuple(found)


def _values(vehicle: VehicleSeen) -> Iterator[tuple[What, float]]:
    """What is known of a vehicle now: battery and height are no news from a host that is not heard."""
    if vehicle.link is not None:
        yield "link", vehicle.link
    if vehicle.fresh and vehicle.battery is not None:
        yield "battery", vehicle.battery
    if vehicle.fresh and vehicle.height is not None:
        yield "height", vehicle.height
