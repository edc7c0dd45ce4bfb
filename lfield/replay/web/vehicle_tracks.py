"""The ways of vehicles until a time, as lines for the map. Pure."""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from dataclasses import dataclass, field

from lfield.driver.frame import Origin
from lfield.host.status import telemetry_of
from lfield.manifest import DeviceValue
from lfield.operator.team_model.device_tracker import earth_of, vehicle_of
from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.team_state import DeviceState, GeoPosition, LocalPosition, TelemetryReading

#: The least distance of two points in metres, or about that in degrees, and the most points that are kept.
_DISTANCE, _DEGREES, _MOST_POINTS = 0.1, 1e-6, 20_000
#: The most points of a line.
MAX_POINTS = 400

#: A position in the team's frame and on the Earth, as far as known.
_Point = tuple[LocalPosition | None, GeoPosition | None]


@dataclass(slots=True)
class _Track:
    times: array[float] = field(default_factory=lambda: array("d"))
    points: list[_Point] = field(default_factory=list)
    step: float = 1.0
    values: dict[str, DeviceValue] = field(default_factory=dict)


class VehicleTracks:
    """The tracks of the agents of a team."""

    def __init__(self, contents: TeamContents) -> None:
        self._contents = contents
        self._origin: Origin | None = contents.origin
        self._tracks: dict[str, _Track] = {}

    def add(self, agent: str, device: str, quantity: str, time: float, value: DeviceValue) -> None:
        """Add a position that a device has reported."""
        track = self._tracks.setdefault(agent, _Track())
        if track.times and time < track.times[-1]:
            return
        track.values[quantity] = value
        readings = {name: TelemetryReading(known, 0.0) for name, known in telemetry_of(track.values).items()}
        state = (DeviceState(device, agent, "", fresh=True, readings=readings),)
        if self._origin is None and (first := earth_of(state, self._contents)) is not None:
            self._origin = Origin(first.latitude, first.longitude, first.altitude or 0.0)
        vehicle = vehicle_of(TeamEntry(agent, "", ""), state, "", self._contents, self._origin)
        point = vehicle.place, vehicle.earth
        if vehicle.stated or (track.points and not _is_apart(track.points[-1], point, track.step)):
            return
        track.times.append(time)
        track.points.append(point)
        if len(track.points) > _MOST_POINTS:
            del track.points[1:-1:2], track.times[1:-1:2]
            track.step *= 2.0

    def until(self, time: float) -> dict[str, list[_Point]]:
        """The track of each agent up to a time, at most `MAX_POINTS` points."""
        found = {}
        for agent, track in self._tracks.items():
            stop = bisect_right(track.times, time)
            step = max(1, -(-stop // MAX_POINTS))
            found[agent] = track.points[:stop][::-1][::step][::-1]
        return found


def _is_apart(one: _Point, other: _Point, step: float) -> bool:
    for before, after, least in ((one[0], other[0], _DISTANCE), (one[1], other[1], _DEGREES)):
        if (before is None) is not (after is None):
            return True
        if before is not None and after is not None and math.dist(before[:2], after[:2]) >= step * least:
            return True
    return False
