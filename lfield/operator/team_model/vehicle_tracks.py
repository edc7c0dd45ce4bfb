"""Tracks of vehicles as lines for the map: points that are apart, thinned when there are many. Pure."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterable

from msgspec import Struct, field

from lfield.operator.team_model.team_state import AgentTrack, TrackPoint, TrackUpdate, VehicleState

#: The least distance of two points in metres, or about that in degrees.
_DISTANCE, _DEGREES = 0.1, 1e-6
#: The most points of a line that are sent, and that are kept.
MAX_POINTS, MOST_KEPT = 400, 4000
#: The most vehicles: hosts may report any number of devices.
MAX_TRACKS = 1024


class TrackHistory(Struct):
    """The way of one vehicle: points with rising marks, which are times or numbers."""

    limit: int = MOST_KEPT
    marks: array[float] = field(default_factory=lambda: array("d"))
    points: list[TrackPoint] = field(default_factory=list)
    step: float = 1.0

    def add(self, mark: float, point: TrackPoint) -> bool:
        """Add a point unless it is close to the last one."""
        if self.points and not _is_apart(self.points[-1], point, self.step):
            return False
        self.marks.append(mark)
        self.points.append(point)
        if len(self.points) > self.limit:
            del self.points[1:-1:2], self.marks[1:-1:2]
            self.step *= 2.0
        return True

    def until(self, mark: float) -> list[TrackPoint]:
        """At most `MAX_POINTS` points with marks up to `mark`, the newest of them included."""
        stop = bisect_right(self.marks, mark)
        step = max(1, -(-stop // MAX_POINTS))
        return self.points[:stop][::-1][::step][::-1]

    def after(self, mark: float) -> list[TrackPoint]:
        """The points with marks after `mark`."""
        return self.points[bisect_right(self.marks, mark) :]


class TeamTracks:
    """The tracks of the vehicles of a running team. Points are numbered from 1 in the order of arrival."""

    def __init__(self) -> None:
        self._tracks: dict[str, TrackHistory] = {}
        self._newest = 0

    def add(self, vehicles: Iterable[VehicleState]) -> None:
        """Add the present positions of vehicles that report one."""
        for vehicle in vehicles:
            point = point_of(vehicle)
            if point is None or not vehicle.fresh:
                continue
            if vehicle.agent not in self._tracks and len(self._tracks) >= MAX_TRACKS:
                continue
            if self._tracks.setdefault(vehicle.agent, TrackHistory()).add(self._newest + 1, point):
                self._newest += 1

    def since(self, after: int) -> TrackUpdate:
        """The points after a number; all, thinned, for a number that was not given out."""
        is_whole = not 0 < after <= self._newest
        found = (
            AgentTrack(agent, track.until(math.inf) if is_whole else track.after(after))
            for agent, track in self._tracks.items()
        )
        return TrackUpdate(self._newest, is_whole, [track for track in found if track.points])


def point_of(vehicle: VehicleState) -> TrackPoint | None:
    """The position of a vehicle as a point; None for one without a measured position."""
    if vehicle.is_position_stated or (vehicle.position is None and vehicle.geo_position is None):
        return None
    local = vehicle.position
    position = None if local is None else (round(local.north, 2), round(local.east, 2))
    geo = vehicle.geo_position
    return TrackPoint(position, None if geo is None else (round(geo.latitude, 7), round(geo.longitude, 7)))


def _is_apart(point: TrackPoint, other: TrackPoint, step: float) -> bool:
    for before, after, minimum in (
        (point.position, other.position, _DISTANCE),
        (point.geo_position, other.geo_position, _DEGREES),
    ):
        if (before is None) is not (after is None):
            return True
        if before is not None and after is not None and math.dist(before, after) >= step * minimum:
            return True
    return False
