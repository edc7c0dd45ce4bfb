"""Home of an autopilot: the place of arming, its drift with GNSS altitude, and the destination of a return.

PX4 sets home at arming, takeoff and landing, and in flight its height drifts with GNSS (trace
`px4-copter.i-heights`: 54 values in a minute, from -1.5 to +1.4 m). ArduCopter's stays within a centimetre;
ArduRover always uses 0.19 m above mean sea level (`ap-rover.i-heights`).

A return leads to the nearest rally point, or home when that is nearer: ArduPilot by RALLY_LIMIT_KM and
RALLY_INCL_HOME (https://ardupilot.org/copter/docs/common-rally-points.html), PX4 by RTL_TYPE 0
(https://docs.px4.io/main/en/flight_modes/return).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from random import Random

from lfield_sim.autopilot.body.goals import ZERO, Vector

#: Maximum height error in metres, the share that remains after a step, and its renewal.
WORST, LEFT, RENEWED = 1.45, 0.7, 0.6
#: Seconds between two steps of the error.
PERIOD = 1.0


class Home:
    """Home in the local frame, metres north, east, down.

    `rng` drives its GNSS drift. Call `set_place` to set it, and `step` to advance time.
    """

    def __init__(self, rng: Random) -> None:
        self._rng = rng
        self._since_renewal = 0.0
        self._error = 0.0
        self._flew = False
        self._reference = ZERO
        #: The rally points in the local frame, and the destination of the present return.
        self.rally: list[Vector] = []
        self.rally_point: Vector | None = None

    @property
    def place(self) -> Vector:
        """The reported position of home."""
        return (self._reference[0], self._reference[1], self.ground - self._error)

    @property
    def ground(self) -> float:
        """The height of home when it was set, down."""
        return self._reference[2]

    def set_place(self, place: Vector) -> None:
        """Sets home, without an error at first."""
        self._reference, self._error, self._since_renewal = place, 0.0, 0.0

    @property
    def destination(self) -> Vector:
        """The destination of the present return."""
        return self.rally_point or self.place

    def start_return(self, place: Vector, parameters: Mapping[str, float]) -> Vector:
        """Selects and returns the destination of a return from `place`."""

        def distance(point: Vector) -> float:
            return math.dist(point[:2], place[:2])

        limit, nearest = (
            1000.0 * parameters.get("RALLY_LIMIT_KM", 0.0),
            min(self.rally, key=distance, default=None),
        )
        if nearest is not None and (
            (limit > 0.0 and distance(nearest) > limit)
            or (parameters.get("RALLY_INCL_HOME", 1.0) and distance(self.place) <= distance(nearest))
        ):
            nearest = None
        self.rally_point = nearest
        return self.destination

    def step(self, dt: float, place: Vector, *, flying: bool) -> None:
        """Advances PX4's time by `dt` seconds: a new height each second in flight, a new home afterwards."""
        if self._flew and not flying:
            self.set_place(place)
        self._flew = flying
        self._since_renewal = self._since_renewal + dt if flying else 0.0
        while self._since_renewal >= PERIOD:
            self._since_renewal -= PERIOD
            self._renew()

    def _renew(self) -> None:
        error = LEFT * self._error + self._rng.gauss(0.0, RENEWED)
        self._error = max(-WORST, min(WORST, error))
