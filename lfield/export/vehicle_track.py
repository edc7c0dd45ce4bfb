"""Poses and tracks of vehicles from telemetry, for map and 3D view. Pure.

If the mission states a frame of the team, a position in it takes precedence over one on the Earth.
Otherwise each vehicle has an origin of its own, and only positions on the Earth are comparable. Without an
origin of the team the map starts at the first position on the Earth.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import Struct, field

from lfield.driver.frame import Origin
from lfield.export.channels import Channel, ChannelMessage, timestamp, topic_part
from lfield.export.export_input import MissionInfo, TelemetrySample
from lfield.export.foxglove_schemas import FRAME_TRANSFORMS, LOCATION_FIX, SCENE_UPDATE
from lfield.export.scene import (
    MAP_FRAME,
    NO_ROTATION,
    TEAM_FRAME,
    TEAM_IN_MAP,
    MapPoint,
    Rotation,
    attitude_in_map,
    color,
    entity,
    map_point,
    pose,
    rounded,
)
from lfield.operator.team_model.team_state import GeoPosition, LocalPosition, TelemetryReading
from lfield.operator.team_model.vehicle_readings import (
    Instruments,
    geo_to_local,
    local_to_geo,
    to_geo_position,
    to_local_position,
    to_number,
)
from lfield.wire.fields import Telemetry

#: The most points of a drawn track; beyond them every second one is dropped, and the distance doubles.
MAX_POINTS = 400
#: The least distance of two points in metres, at first.
FIRST_DISTANCE = 0.1
#: The least seconds between two drawings of a track.
TRACK_INTERVAL = 1.0
#: Seconds for which a vehicle with an origin of its own waits for its first position on the Earth.
EARTH_TIMEOUT = 2.0
#: The quantity with roll, pitch and yaw in radians.
ATTITUDE = "attitude"
#: Colours of tracks, one after another: red, green and blue.
_COLORS = ((0.12, 0.47, 0.71), (0.89, 0.10, 0.11), (0.20, 0.63, 0.17), (0.42, 0.24, 0.60), (0.69, 0.35, 0.16))
#: Position covariance is unknown.
_NO_COVARIANCE = [0.0] * 9

TRANSFORMS = Channel("/tf", FRAME_TRANSFORMS)


class Track(Struct):
    """The line behind a vehicle: at most `MAX_POINTS` points over the whole way."""

    points: list[dict[str, float]] = field(default_factory=list)
    last: MapPoint | None = None
    distance: float = FIRST_DISTANCE
    drawn_at: float = -TRACK_INTERVAL
    #: Whether the track has points that are not drawn yet.
    is_longer: bool = False

    def add(self, point: MapPoint) -> None:
        """Add a position, if it is far enough from the last one."""
        if self.last is not None and _distance(self.last, point) < self.distance:
            return
        self.last = point
        self.points.append(rounded(point))
        self.is_longer = True
        if len(self.points) > MAX_POINTS:
            del self.points[1:-1:2]
            self.distance *= 2.0

    def is_due(self, now: float) -> bool:
        """Whether to draw the track; then it counts as drawn."""
        if not self.is_longer or abs(now - self.drawn_at) < TRACK_INTERVAL:
            return False
        self.drawn_at, self.is_longer = now, False
        return True


def _distance(point: MapPoint, other: MapPoint) -> float:
    return max(abs(a - b) for a, b in zip(point, other, strict=True))


class _Vehicle(Struct):
    """A device with a position, with its last values by quantity and the channels of its messages."""

    instruments: Instruments
    color: tuple[float, float, float]
    fixes: Channel
    tracks: Channel
    first_at: float
    values: dict[str, Telemetry] = field(default_factory=dict)
    track: Track = field(default_factory=Track)

    def reading(self, quantity: str) -> TelemetryReading | None:
        """The last value of a quantity."""
        return TelemetryReading(self.values[quantity], 0.0) if quantity in self.values else None


class VehicleTracker:
    """The positions of all devices of a team."""

    def __init__(self, info: MissionInfo) -> None:
        self._info, self._origin = info, info.origin
        self._vehicles: dict[str, _Vehicle] = {}
        #: The last position of each device, by its host.
        self._places: dict[str, dict[str, MapPoint]] = {}
        self._frame_published = False

    def place(self, host: str) -> MapPoint | None:
        """The last position of a host: of its first device with one, else as in the devices file."""
        for point in self._places.get(host, {}).values():
            return point
        stated = self._info.frames.place(host)
        return None if stated is None else map_point(*stated)

    def messages(self, sample: TelemetrySample) -> Iterator[ChannelMessage]:
        """The pose, the position on the Earth and the track of a device that has reported a position."""
        vehicle = self._vehicle(sample)
        vehicle.values.update(sample.values)
        instruments = vehicle.instruments
        if not sample.values.keys() & {
            instruments.position,
            instruments.geo_position,
            instruments.heading,
            ATTITUDE,
        }:
            return
        place, geo = self._positions(vehicle)
        if self._is_early(vehicle, sample.time):
            return
        if geo is not None and sample.values.keys() & {instruments.position, instruments.geo_position}:
            yield ChannelMessage(vehicle.fixes, sample.time, _fix(sample, geo))
        if place is None:
            return
        point = map_point(place.north, place.east, place.down or 0.0)
        self._places.setdefault(sample.host, {})[sample.device] = point
        if not self._frame_published:
            self._frame_published = True
            team = _transform(sample.time, TEAM_FRAME, MapPoint(0.0, 0.0, 0.0), TEAM_IN_MAP)
            yield ChannelMessage(TRANSFORMS, sample.time, {"transforms": [team]})
        pose = _transform(sample.time, sample.device, point, _attitude(vehicle))
        yield ChannelMessage(TRANSFORMS, sample.time, {"transforms": [pose]})
        vehicle.track.add(point)
        if vehicle.track.is_due(sample.time):
            yield ChannelMessage(vehicle.tracks, sample.time, _drawing(sample, vehicle))

    def _vehicle(self, sample: TelemetrySample) -> _Vehicle:
        device = sample.device
        vehicle = self._vehicles.get(device)
        if vehicle is None:
            topic, color = f"/devices/{topic_part(device)}", _COLORS[len(self._vehicles) % len(_COLORS)]
            vehicle = self._vehicles[device] = _Vehicle(
                self._info.instruments(device),
                color,
                Channel(f"{topic}/fix", LOCATION_FIX),
                Channel(f"{topic}/track", SCENE_UPDATE),
                sample.time,
            )
        return vehicle

    def _is_early(self, vehicle: _Vehicle, now: float) -> bool:
        """Whether a position on the Earth, which would be comparable, may still come."""
        may_come = (
            bool(vehicle.instruments.geo_position) and vehicle.instruments.geo_position not in vehicle.values
        )
        return may_come and not self._info.frames and abs(now - vehicle.first_at) < EARTH_TIMEOUT

    def _positions(self, vehicle: _Vehicle) -> tuple[LocalPosition | None, GeoPosition | None]:
        """The position in the team's frame, and on the Earth."""
        instruments = vehicle.instruments
        place = to_local_position(vehicle.reading(instruments.position))
        geo = to_geo_position(vehicle.reading(instruments.geo_position))
        if self._origin is None and geo is not None:
            self._origin = Origin(geo.latitude, geo.longitude, geo.altitude or 0.0)
        if self._origin is not None and geo is not None and (place is None or not self._info.frames):
            place = geo_to_local(geo, self._origin)
        elif self._info.origin is not None and geo is None and place is not None:
            geo = local_to_geo(place, self._info.origin)
        height = to_number(vehicle.reading(instruments.height))
        if place is not None and place.down is None and height is not None:
            place = place._replace(down=-height)
        return place, geo


def _attitude(vehicle: _Vehicle) -> Rotation:
    angles = vehicle.values.get(ATTITUDE)
    if isinstance(angles, list) and len(angles) == 3:
        found = [to_number(TelemetryReading(each, 0.0)) for each in angles]
        if None not in found:
            return attitude_in_map(*(each or 0.0 for each in found))
    heading = to_number(vehicle.reading(vehicle.instruments.heading))
    return NO_ROTATION if heading is None else attitude_in_map(0.0, 0.0, heading)


def _fix(sample: TelemetrySample, place: GeoPosition) -> dict[str, Any]:
    return {
        "timestamp": timestamp(sample.time),
        "frame_id": sample.device,
        "latitude": place.latitude,
        "longitude": place.longitude,
        "altitude": place.altitude or 0.0,
        "position_covariance": _NO_COVARIANCE,
        "position_covariance_type": 0,
    }


def _transform(time: float, frame: str, point: MapPoint, turned: Rotation) -> dict[str, Any]:
    return {
        "timestamp": timestamp(time),
        "parent_frame_id": MAP_FRAME,
        "child_frame_id": frame,
        "translation": point._asdict(),
        "rotation": turned._asdict(),
    }


def _drawing(sample: TelemetrySample, vehicle: _Vehicle) -> dict[str, Any]:
    """The whole line so far, so that a viewer that jumps to this time shows it."""
    line = {
        "type": 0,
        "pose": pose(MapPoint(0.0, 0.0, 0.0)),
        "thickness": 0.1,
        "scale_invariant": False,
        "points": vehicle.track.points,
        "color": color(*vehicle.color),
        "colors": [],
        "indices": [],
    }
    return {"deletions": [], "entities": [entity(sample.time, f"track of {sample.device}", lines=[line])]}
