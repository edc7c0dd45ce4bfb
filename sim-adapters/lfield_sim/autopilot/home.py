"""Home as the autopilot sees it: where it was armed, what GNSS makes of its height, and where it returns to.

PX4 takes home anew at arming, takeoff and landing, and in between its height moves with GNSS for as long as
it flies (trace `px4-copter.i-heights`: 54 values in a minute, from -1.5 to +1.4 m). ArduCopter's stays within
a centimetre; ArduRover takes 0.19 m above mean sea level for it, wherever that is (`ap-rover.i-heights`).

A return leads to the nearest rally point, or home when that is nearer: with ArduPilot by RALLY_LIMIT_KM and
RALLY_INCL_HOME (https://ardupilot.org/copter/docs/common-rally-points.html), with PX4 by RTL_TYPE 0
(https://docs.px4.io/main/en/flight_modes/return).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from random import Random

from lfield_sim.autopilot.body.goals import ZERO, Vector

#: Metres that a height may be wrong by, how much of an error is left after a step, and how it is renewed.
WORST, LEFT, RENEWED = 1.45, 0.7, 0.6
#: Seconds between two steps of the error.
PERIOD = 1.0


class Home:
    """Where home is in the local frame, metres north, east, down.

    `dice` make what GNSS does to its height. Who takes home anew says so by `take`; who lets time pass by
    `step` has the rest done for it.
    """

    def __init__(self, dice: Random) -> None:
        self._dice = dice
        self._rest = 0.0
        self._error = 0.0
        self._flew = False
        self._taken = ZERO
        #: The rally points in the local frame, and the one that the present return leads to.
        self.rally: list[Vector] = []
        self.rallies_at: Vector | None = None

    @property
    def place(self) -> Vector:
        """Where it is told to be now."""
        return (self._taken[0], self._taken[1], self.ground - self._error)

    @property
    def ground(self) -> float:
        """How far down it was when it was taken."""
        return self._taken[2]

    def take(self, place: Vector) -> None:
        """It is here from now on, its height right for the moment."""
        self._taken, self._error, self._rest = place, 0.0, 0.0

    @property
    def destination(self) -> Vector:
        """Where the present return leads."""
        return self.rallies_at or self.place

    def begin_return(self, here: Vector, parameters: Mapping[str, float]) -> Vector:
        """Choose where a return from `here` leads, and tell that."""

        def far(place: Vector) -> float:
            return math.dist(place[:2], here[:2])

        limit, nearest = (
            1000.0 * parameters.get("RALLY_LIMIT_KM", 0.0),
            min(self.rally, key=far, default=None),
        )
        if nearest is not None and (
            (limit > 0.0 and far(nearest) > limit)
            or (parameters.get("RALLY_INCL_HOME", 1.0) and far(self.place) <= far(nearest))
        ):
            nearest = None
        self.rallies_at = nearest
        return self.destination

    def step(self, dt: float, here: Vector, *, flying: bool) -> None:
        """Let `dt` seconds of PX4 pass: in flight a new height each second, after it a new home."""
        if self._flew and not flying:
            self.take(here)
        self._flew = flying
        self._rest = self._rest + dt if flying else 0.0
        while self._rest >= PERIOD:
            self._rest -= PERIOD
            self._renew()

    def _renew(self) -> None:
        error = LEFT * self._error + self._dice.gauss(0.0, RENEWED)
        self._error = max(-WORST, min(WORST, error))
