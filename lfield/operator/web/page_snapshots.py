"""One look at a team as the page gets it: what `TeamState` has, as JSON, without what no page shows.

`TeamState`, its parts and their units are in team_model/team_state.py; named tuples are arrays here. The page
draws just that, so a look is whole: a page that was asleep needs one, not all that it has missed. All
browsers get the same bytes; only the lines of the log are for each those that it does not have yet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import msgspec

from lfield.operator.team_model.log_buffer import MAX_LINES
from lfield.operator.team_model.team_state import (
    Curve,
    HostState,
    ShownLogLine,
    TeamState,
    TeamStateSource,
    VehicleState,
)
from lfield.operator.web.button_orders import MAX_DELAY
from lfield.wire.order_messages import OrderKind

#: Seconds between two looks, at least, however many browsers ask; one asks five times a second (server.js).
MIN_INTERVAL = 0.05
#: So many lines of the log a page gets at once, the newest, and keeps (log.js).
MAX_LOG_LINES = MAX_LINES
#: So many points a curve of a plot has at most.
MAX_POINTS = 150


#: Fields of a host that no page gets: vehicles have its devices, `trouble` words its error.
_NOT_SHOWN = ("error", "devices", "report")
_HOST_FIELDS = tuple(each.name for each in fields(HostState) if each.name not in _NOT_SHOWN)


def team_json(state: TeamState, denied: Mapping[OrderKind, str], tiles: Mapping[str, Any] | None) -> bytes:
    """All that is shown but the log, as a JSON object."""
    return msgspec.json.encode(
        {
            "team": state.team,
            "hosts": [{name: getattr(host, name) for name in _HOST_FIELDS} for host in state.hosts.values()],
            "vehicles": [_slim(vehicle) for vehicle in state.vehicles.values()],
            "coordinators": list(state.coordinators.values()),
            "offers": list(state.offers.values()),
            "stop": state.stop,
            "orders": state.orders,
            "stands": state.stop.stands,
            "complete": state.stop.complete,
            "paused": state.paused,
            "barred": denied,
            "tiles": tiles,
            "prompt": MAX_DELAY,
            "lines": MAX_LOG_LINES,
        }
    )


def _slim(vehicle: VehicleState) -> VehicleState:
    """Without its telemetry: what of that is shown has been picked out of it."""
    return replace(vehicle, devices=tuple(replace(device, readings={}) for device in vehicle.devices))


def log_json(log: Sequence[ShownLogLine], after: int) -> bytes:
    """The lines of the log behind that number, as a JSON array of objects."""
    first = len(log)
    while first and log[first - 1].serial > after and len(log) - first < MAX_LOG_LINES:
        first -= 1
    return msgspec.json.encode([line._asdict() for line in log[first:]])


def plots_json(curves: Sequence[Curve]) -> bytes:
    """Curves for the plots as JSON, each with as many points as can be told apart."""
    return msgspec.json.encode([replace(curve, points=_thinned(curve.points)) for curve in curves])


def _thinned(points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    step = -(-len(points) // MAX_POINTS)
    if step <= 1:
        return points
    # Counted from the newest, which is always there.
    return points[::-1][::step][::-1]


@dataclass(slots=True)
class PageSnapshots:
    """Looks at a team when browsers ask, `MIN_INTERVAL` seconds apart at least; `now` is a monotonic clock
    (s).
    """

    source: TeamStateSource
    denied_orders: Callable[[], Mapping[OrderKind, str]]
    tiles: Mapping[str, Any] | None
    now: Callable[[], float]
    _state: TeamState | None = None
    _team: bytes = b""
    _at: float = 0.0

    def snapshot(self, after: int) -> bytes:
        """What a browser gets that has the log until that number: `{"at": s, "look": {...}, "log": [...]}`.

        `at` is when the look was made, by `now`.
        """
        now = self.now()
        if self._state is None or now - self._at >= MIN_INTERVAL:
            self._state, self._at = self.source.snapshot(), now
            self._team = team_json(self._state, self.denied_orders(), self.tiles)
        log = log_json(self._state.log, after)
        return b'{"at":%b,"look":%b,"log":%b}' % (msgspec.json.encode(self._at), self._team, log)

    def plots(self) -> bytes:
        """What its plots show."""
        return plots_json(self.source.curves())
