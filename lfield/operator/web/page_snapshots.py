"""Snapshots of a team as JSON for the page: the fields of `TeamState` that the page shows.

`TeamState`, its parts and their units are in team_model/team_state.py; named tuples become arrays. Each
snapshot is complete, so a page that was inactive needs only the newest. All browsers get the same bytes,
except the lines of the log and the points of tracks, of which each gets those that it does not have yet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import msgspec
from msgspec.structs import replace

from lfield.operator.team_model.log_buffer import MAX_LINES
from lfield.operator.team_model.team_state import (
    Curve,
    HostState,
    ShownLogLine,
    TeamState,
    TeamStateSource,
    TrackUpdate,
    VehicleState,
)
from lfield.operator.web.button_orders import MAX_DELAY
from lfield.wire.order_messages import OrderKind

#: Least seconds between two snapshots, for any number of browsers; a browser asks 5 times a second
#: (server.js).
MIN_INTERVAL = 0.05
#: Maximum number of log lines that a page gets at once, the newest, and keeps (log.js).
MAX_LOG_LINES = MAX_LINES
#: Maximum number of points of a curve.
MAX_POINTS = 150


#: Fields of hosts and vehicles that the page does not show. `vehicles` has the devices of hosts.
_HIDDEN_OF_HOST = {
    *("error", "devices", "report", "uptime", "restarts", "jitter", "clock_uncertainty", "position"),
}
_HIDDEN_OF_VEHICLE = {"devices", "type", "position_age", "is_position_stated", "speed", "refusal"}
_HOST_FIELDS = tuple(name for name in HostState.__struct_fields__ if name not in _HIDDEN_OF_HOST)
_VEHICLE_FIELDS = tuple(name for name in VehicleState.__struct_fields__ if name not in _HIDDEN_OF_VEHICLE)
#: Fields of a device that the page shows.
_DEVICE_FIELDS = ("name", "fresh", "latched", "confirmed", "moving")


def team_json(state: TeamState, denied: Mapping[OrderKind, str], tiles: Mapping[str, Any] | None) -> bytes:
    """The whole state except the log, as a JSON object."""
    return msgspec.json.encode(
        {
            "name": state.team,
            "hosts": [_fields(host, _HOST_FIELDS) for host in state.hosts.values()],
            "vehicles": [_vehicle_data(vehicle) for vehicle in state.vehicles.values()],
            "coordinators": list(state.coordinators.values()),
            "offers": list(state.offers.values()),
            "stop": state.stop,
            "orders": state.orders,
            "is_stopped": state.stop.is_active,
            "is_stop_complete": state.stop.is_complete,
            "paused": state.paused,
            "denied_orders": denied,
            "tiles": tiles,
            "press_timeout": MAX_DELAY,
            "max_log_lines": MAX_LOG_LINES,
        }
    )


def _vehicle_data(vehicle: VehicleState) -> dict[str, Any]:
    devices = [_fields(device, _DEVICE_FIELDS) for device in vehicle.devices]
    return {**_fields(vehicle, _VEHICLE_FIELDS), "devices": devices}


def _fields(state: object, names: Sequence[str]) -> dict[str, Any]:
    return {name: getattr(state, name) for name in names}


def log_json(log: Sequence[ShownLogLine], after: int) -> bytes:
    """The log lines after that number, as a JSON array of objects."""
    first = len(log)
    while first and log[first - 1].serial > after and len(log) - first < MAX_LOG_LINES:
        first -= 1
    return msgspec.json.encode([line._asdict() for line in log[first:]])


def tracks_json(update: TrackUpdate) -> bytes:
    """New points of tracks as JSON."""
    tracks = [track._asdict() for track in update.tracks]
    return msgspec.json.encode({"newest": update.newest, "is_whole": update.is_whole, "tracks": tracks})


def plots_json(curves: Sequence[Curve]) -> bytes:
    """Curves for the plots as JSON, each with at most `MAX_POINTS` points."""
    return msgspec.json.encode([replace(curve, points=_thinned(curve.points)) for curve in curves])


def _thinned(points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    step = -(-len(points) // MAX_POINTS)
    if step <= 1:
        return points
    # Counted from the newest point, which is always included.
    return points[::-1][::step][::-1]


class ShownPosition(NamedTuple):
    """A state of a recorded team, and the position in the recordings as JSON (browser/replay.js).

    `epoch` is the number of its log: lines of another one are not valid any more.
    """

    state: TeamState
    epoch: int
    position: bytes


class ReplayControl(TeamStateSource, Protocol):
    """Recordings whose time can be moved. No request reaches a host."""

    def published(self) -> ShownPosition:
        """The newest state and position."""

    def request(self, body: object) -> str:
        """Request a move by the unchecked body of a request; returns the reason of a refusal, '' if
        accepted.
        """


class PageSnapshots(msgspec.Struct):
    """Makes snapshots on request, at most one per `MIN_INTERVAL`; `now` is a monotonic clock (s).

    With a `replay` the snapshots show the position in recordings.
    """

    source: TeamStateSource
    denied_orders: Callable[[], Mapping[OrderKind, str]]
    tiles: Mapping[str, Any] | None
    now: Callable[[], float]
    replay: ReplayControl | None = None
    _state: TeamState | None = None
    _team: bytes = b""
    _at: float = 0.0
    _epoch: int = 0
    _position: bytes = b"null"

    def snapshot(self, after: int, epoch: int = 0, point: int = 0) -> bytes:
        """A snapshot with the log lines and track points after those numbers, `{"at": s, ...}`.

        `at` is the time of the snapshot by `now`, `replay` the position in recordings, null for a running
        team. A log of another `epoch` is sent again from its first line.
        """
        now = self.now()
        if self._state is None or now - self._at >= MIN_INTERVAL:
            self._state, self._at = self._newest_state(), now
            self._team = team_json(self._state, self.denied_orders(), self.tiles)
        log = log_json(self._state.log, after if epoch == self._epoch else 0)
        tracks = tracks_json(self.source.tracks(point))
        parts = msgspec.json.encode(self._at), self._team, log, tracks, self._epoch, self._position
        return b'{"at":%b,"team":%b,"log":%b,"tracks":%b,"epoch":%d,"replay":%b}' % parts

    def _newest_state(self) -> TeamState:
        if self.replay is None:
            return self.source.snapshot()
        state, self._epoch, self._position = self.replay.published()
        return state

    def plots(self) -> bytes:
        """The curves of the plots as JSON."""
        return plots_json(self.source.curves())
