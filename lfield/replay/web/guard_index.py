"""Index of the guards' recordings by the team's time: poses and batteries of devices, tracks, safe states."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path

from msgspec import Struct, field

from lfield.driver.frame import Origin
from lfield.errors import RecordingError
from lfield.guard.recording.guard_segments import TelemetryValue, rings_in, telemetry_in
from lfield.host.status import telemetry_of
from lfield.manifest import DeviceValue
from lfield.operator.team_model.device_tracker import geo_position_of, vehicle_of
from lfield.operator.team_model.team_contents import TeamContents, TeamEntry
from lfield.operator.team_model.team_state import DeviceState, TelemetryReading, TrackPoint, agent_of
from lfield.operator.team_model.vehicle_tracks import TrackHistory, point_of
from lfield.replay.debugger.team_timeline import TeamTimeline
from lfield.replay.device_events import DeviceEvent, device_events, outside_events
from lfield.replay.host_recording import OutsideEvent
from lfield.replay.recording_files import TeamRecording
from lfield.replay.web.recorded_events import EventIndex
from lfield.wire.events import Event

#: The meanings of quantities that the page shows; others are not kept.
_QUANTITY_MEANINGS = (
    "position",
    "geo_position",
    "heading",
    "speed",
    "height",
    "battery",
    "mode",
    "armed",
    "home",
    "fence",
)
#: The most points of the track of a vehicle that are kept.
_MOST_POINTS = 20_000


class _Trace(Struct):
    """The values of a quantity with the times of their changes."""

    times: array[float] = field(default_factory=lambda: array("d"))
    values: list[DeviceValue] = field(default_factory=list)


class _RecordedTrack(Struct):
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
        if self._origin is None and (first := geo_position_of(state, self._contents)) is not None:
            self._origin = Origin(first.latitude, first.longitude, first.altitude or 0.0)
        vehicle = vehicle_of(TeamEntry(agent, "", ""), state, "", self._contents, self._origin)
        if (point := point_of(vehicle)) is not None:
            recorded.track.add(time, point)

    def until(self, time: float) -> dict[str, list[TrackPoint]]:
        """The track of each agent up to a time, at most `MAX_POINTS` points."""
        return {agent: recorded.track.until(time) for agent, recorded in self._tracks.items()}


class GuardIndex:
    """The recordings of all guards of a recording of a team.

    `steps` reads them, one record at a time; decisions about safe states and notes become events of `index`.
    """

    def __init__(
        self, recording: TeamRecording, team: TeamTimeline, contents: TeamContents, index: EventIndex
    ) -> None:
        self._recording, self._team, self._contents, self._index = recording, team, contents, index
        self._traces: dict[str, dict[str, _Trace]] = {}
        #: The recordings with telemetry of each device.
        self._hosts: dict[str, int] = {}
        self.tracks = VehicleTracks(contents)
        #: The unreadable parts, a sentence each.
        self.problems: list[str] = []

    def steps(self) -> Iterator[None]:
        """Read the files; the caller may pause after each step."""
        for incarnation in self._recording.incarnations:
            numbers = [
                number
                for number, host in enumerate(self._team.hosts)
                if any(host.recording is part for part in incarnation.parts)
            ]
            if not numbers:
                continue
            for paths in rings_in(incarnation.folder).values():
                try:
                    yield from self._ring_steps(numbers, paths, outside_events(incarnation.parts))
                except RecordingError as error:
                    self.problems.append(str(error))

    def _ring_steps(
        self, numbers: list[int], paths: Iterable[Path], logged: Collection[OutsideEvent]
    ) -> Iterator[None]:
        paths = list(paths)
        for value in telemetry_in(paths):
            self._add_value(numbers, value)
            yield
        for event in device_events(paths, logged):
            self._add_event(numbers, event)
            yield

    def values_at(self, device: str, time: float) -> tuple[dict[str, DeviceValue], float] | None:
        """The values of a device at a time, and the age of the newest; None without any."""
        found: dict[str, DeviceValue] = {}
        newest = -1.0
        for quantity, trace in self._traces.get(device, {}).items():
            if at := bisect_right(trace.times, time):
                found[quantity] = trace.values[at - 1]
                newest = max(newest, trace.times[at - 1])
        return (found, time - newest) if found else None

    @property
    def devices(self) -> Mapping[str, int]:
        """The devices with telemetry, and the newest recording that has it."""
        return self._hosts

    def _add_value(self, numbers: list[int], value: TelemetryValue) -> None:
        instruments = self._contents.instruments(value.device)
        if value.quantity not in {getattr(instruments, meaning) for meaning in _QUANTITY_MEANINGS}:
            return
        number, time = self._team_time(numbers, value.time)
        self._hosts[value.device] = number
        trace = self._traces.setdefault(value.device, {}).setdefault(value.quantity, _Trace())
        if trace.times and time < trace.times[-1]:
            return
        trace.times.append(time)
        trace.values.append(value.value)
        if value.quantity in (instruments.position, instruments.geo_position):
            self.tracks.add(agent_of(value.device), value.device, value.quantity, time, value.value)

    def _add_event(self, numbers: list[int], event: DeviceEvent) -> None:
        number, time = self._team_time(numbers, event.time)
        start = self._team.hosts[number].recording.start
        uptime = max(0.0, event.time - start.at)
        # Events of a number up to 0 would be those before a snapshot.
        self._index.add(time, number, Event(1, start.wall + event.time - start.at, uptime, 0, event.what))

    def _team_time(self, numbers: list[int], at: float) -> tuple[int, float]:
        """The recording that was made at a time of the host's clock, and the time of the team."""
        hosts, times = self._team.hosts, self._team.times
        number = max((n for n in numbers if hosts[n].ats[0] <= at), default=numbers[0])
        turn = max(0, bisect_right(hosts[number].ats, at) - 1)
        return number, times[number][turn] + at - hosts[number].ats[turn]
