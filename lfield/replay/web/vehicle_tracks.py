"""The ways of vehicles until a time, as lines for the map. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from lfield.driver.frame import Origin
from lfield.host.status import telemetry_of
from lfield.manifest import DeviceValue
from lfield.operator.team_model.device_tracker import earth_of, vehicle_of
from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.team_state import DeviceState, TelemetryReading, TrackPoint
from lfield.operator.team_model.vehicle_tracks import TrackHistory, point_of

#: The most points of a vehicle that are kept.
_MOST_POINTS = 20_000


@dataclass(slots=True)
class _RecordedTrack:
    track: TrackHistory = field(default_factory=lambda: TrackHistory(_MOST_POINTS))
    values: dict[str, DeviceValue] = field(default_factory=dict)


class VehicleTracks:
    """The tracks of the agents of a team."""

    def __init__(self, contents: TeamContents) -> None:
        self._contents = contents
        self._origin: Origin | None = contents.origin
        self._tracks: dict[str, _RecordedTrack] = {}

    def add(self, agent: str, device: str, quantity: str, time: float, value: DeviceValue) -> None:
        """Add a position that a device has reported."""
        recorded = self._tracks.setdefault(agent, _RecordedTrack())
        if recorded.track.marks and time < recorded.track.marks[-1]:
            return
        recorded.values[quantity] = value
        telemetry = telemetry_of(recorded.values)
        readings = {name: TelemetryReading(known, 0.0) for name, known in telemetry.items()}
        state = (DeviceState(device, agent, "", fresh=True, readings=readings),)
        if self._origin is None and (first := earth_of(state, self._contents)) is not None:
            self._origin = Origin(first.latitude, first.longitude, first.altitude or 0.0)
        vehicle = vehicle_of(TeamEntry(agent, "", ""), state, "", self._contents, self._origin)
        if (point := point_of(vehicle)) is not None:
            recorded.track.add(time, point)

    def until(self, time: float) -> dict[str, list[TrackPoint]]:
        """The track of each agent up to a time, at most `MAX_POINTS` points."""
        return {agent: recorded.track.until(time) for agent, recorded in self._tracks.items()}
