"""Curves of the last minutes: vehicle readings, and hops of coordinators per minute. Sans-IO."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import Literal

from lfield.operator.team_model.team_state import Curve, VehicleState

#: Duration and step, in seconds.
WINDOW, STEP = 600.0, 1.0
#: The most curves: hosts may report any number of devices.
MAX_CURVES = 1024

CurveKind = Literal["battery", "height", "link", "hops"]


class CurveHistory:
    """A point per second of each, for ten minutes. Times are on the own monotonic clock."""

    def __init__(self) -> None:
        self._points: dict[tuple[CurveKind, str], deque[tuple[float, float]]] = {}
        self._last: float | None = None

    def add(self, now: float, vehicles: Mapping[str, VehicleState], hops: Mapping[str, float]) -> None:
        """Add the present values; ignored within a step of the last ones."""
        if self._last is not None and now < self._last + STEP:
            return
        self._last = now
        for agent, vehicle in vehicles.items():
            for kind, value in _values(vehicle):
                self._point(kind, agent, now, value)
        for agent, count in hops.items():
            self._point("hops", agent, now, count)

    def _point(self, kind: CurveKind, subject: str, now: float, value: float) -> None:
        points = self._points.get((kind, subject))
        if points is None:
            if len(self._points) >= MAX_CURVES:
                return
            points = self._points[kind, subject] = deque()
        points.append((now, value))
        while points[0][0] < now - WINDOW:
            points.popleft()

    def snapshot(self, now: float) -> tuple[Curve, ...]:
        """All curves, without those that have no point in the window."""
        found = []
        for (kind, subject), points in self._points.items():
            samples = tuple((now - when, value) for when, value in points if when >= now - WINDOW)
            if samples:
                found.append(Curve(kind, subject, samples))
        return tuple(found)


def _values(vehicle: VehicleState) -> Iterator[tuple[CurveKind, float]]:
    """The present values of a vehicle: battery and height only from a linked host."""
    if vehicle.telemetry_age is not None:
        yield "link", vehicle.telemetry_age
    if vehicle.fresh and vehicle.battery is not None:
        yield "battery", vehicle.battery
    if vehicle.fresh and vehicle.height is not None:
        yield "height", vehicle.height
