"""One look at a team as the page gets it: what `Seen` has, as JSON, without what no page shows.

`Seen`, its parts and their units are in sight/seen.py; named tuples are arrays here. The page draws just
that, so a look is whole: a page that was asleep needs one, not all that it has missed. All browsers get the
same bytes; only the lines of the log are for each those that it does not have yet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from lfield.operator.sight.actions import Order
from lfield.operator.sight.picture.loglines import MOST_LINES
from lfield.operator.sight.seen import Curve, LogLine, Seen, Sight, VehicleSeen
from lfield.operator.web.buttons import PROMPT

#: Seconds between two looks, at least, however many browsers ask; one asks five times a second (server.js).
EVERY = 0.05
#: So many lines of the log a page gets at once, the newest, and keeps (log.js).
LINES = MOST_LINES
#: So many points a curve of a plot has at most.
POINTS = 150


def team(seen: Seen, barred: Mapping[Order, str], tiles: Mapping[str, Any] | None) -> bytes:
    """All that is shown but the log, as a JSON object."""
    return msgspec.json.encode(
        {
            "team": seen.team,
            "hosts": list(seen.hosts.values()),
            "vehicles": [_slim(vehicle) for vehicle in seen.vehicles.values()],
            "coordinators": list(seen.coordinators.values()),
            "offers": list(seen.offers.values()),
            "stop": seen.stop,
            "orders": seen.orders,
            "stands": seen.stop.stands,
            "complete": seen.stop.complete,
            "paused": seen.paused,
            "barred": barred,
            "tiles": tiles,
            "prompt": PROMPT,
            "lines": LINES,
        }
    )


def _slim(vehicle: VehicleSeen) -> VehicleSeen:
    """Without its telemetry: what of that is shown has been picked out of it."""
    return replace(vehicle, devices=tuple(replace(device, readings={}) for device in vehicle.devices))


def lines(log: Sequence[LogLine], after: int) -> bytes:
    """The lines of the log behind that number, as a JSON array of objects."""
    first = len(log)
    while first and log[first - 1].serial > after and len(log) - first < LINES:
        first -= 1
    return msgspec.json.encode([line._asdict() for line in log[first:]])


def plots(curves: Sequence[Curve]) -> bytes:
    """Curves for the plots as JSON, each with as many points as can be told apart."""
    return msgspec.json.encode([replace(curve, points=_thinned(curve.points)) for curve in curves])


def _thinned(points: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    step = -(-len(points) // POINTS)
    if step <= 1:
        return points
    # Counted from the newest, which is always there.
    return points[::-1][::step][::-1]


@dataclass(slots=True)
class Looks:
    """Looks at a team when browsers ask, `EVERY` seconds apart at least; `now` is a monotonic clock (s)."""

    sight: Sight
    barred: Callable[[], Mapping[Order, str]]
    tiles: Mapping[str, Any] | None
    now: Callable[[], float]
    _seen: Seen | None = None
    _team: bytes = b""
    _at: float = 0.0

    def look(self, after: int) -> bytes:
        """What a browser gets that has the log until that number: `{"at": s, "look": {...}, "log": [...]}`.

        `at` is when the look was made, by `now`.
        """
        now = self.now()
        if self._seen is None or now - self._at >= EVERY:
            self._seen, self._at = self.sight.seen(), now
            self._team = team(self._seen, self.barred(), self.tiles)
        log = lines(self._seen.log, after)
        return b'{"at":%b,"look":%b,"log":%b}' % (msgspec.json.encode(self._at), self._team, log)

    def plots(self) -> bytes:
        """What its plots show."""
        return plots(self.sight.curves())
