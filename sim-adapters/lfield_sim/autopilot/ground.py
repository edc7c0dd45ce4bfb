"""How a rover moves: as a vehicle with a nose that it drives after, on wheels that steer or by its skids."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfield_sim.autopilot.vehicle import ZERO, Vector, Vehicle, eased, wrap

#: Metres from a place within which it has reached it.
AT_PLACE = 0.05


@dataclass(slots=True)
class GroundVehicle(Vehicle):
    """A rover: it drives where its nose points, and turns to point where it must go.

    `turning_radius` in m is that of its front wheels (Ackermann): such a one turns only as it drives. 0 is
    skid steering, which turns on the spot.
    """

    turning_radius: float = 0.0

    @property
    def airborne(self) -> bool:
        """Never."""
        return False

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        before, heading = self.velocity, self.yaw
        north, east, _ = self._kept_in(self._wanted())
        wanted, along = math.hypot(north, east), math.hypot(*before[:2])
        course = math.atan2(east, north) if wanted > 1e-3 else self.yaw_goal
        turn = self._turning(along) * dt
        if self.yaw_rate_goal is not None:
            # Told how fast to turn, it drives on with its nose as it is.
            self.yaw = wrap(self.yaw + max(-turn, min(turn, self.yaw_rate_goal * dt)))
        elif course is not None:
            self.yaw = wrap(self.yaw + max(-turn, min(turn, wrap(course - self.yaw))))
            wanted *= max(self._slowest_turn, math.cos(wrap(course - self.yaw)))
        self.yaw_rate = wrap(self.yaw - heading) / dt
        limits = self.limits
        felt = math.copysign(math.hypot(*self.acceleration[:2]), self._pushing)
        (push, _) = eased((felt, 0.0), (wanted - along, 0.0), limits.acceleration, limits.jerk, dt)
        speed = max(0.0, along + push * dt)
        self.velocity = (speed * math.cos(self.yaw), speed * math.sin(self.yaw), 0.0)
        self.place = (self.place[0] + self.velocity[0] * dt, self.place[1] + self.velocity[1] * dt, 0.0)
        self.acceleration = (push * math.cos(self.yaw), push * math.sin(self.yaw), 0.0)

    def _approach(self, place: Vector) -> Vector:
        """As a copter; but wheels that steer do not turn back for a place that they have just passed."""
        north, east = place[0] - self.place[0], place[1] - self.place[1]
        far = math.hypot(north, east)
        passed = math.cos(math.atan2(east, north) - self.yaw) < 0.0
        if far < AT_PLACE or (self.turning_radius and passed and far < 2.0 * self.turning_radius):
            return ZERO
        return Vehicle._approach(self, place)

    @property
    def _pushing(self) -> float:
        """Positive while it speeds up, negative while it slows down."""
        north, east, _ = self.acceleration
        return north * math.cos(self.yaw) + east * math.sin(self.yaw)

    @property
    def _slowest_turn(self) -> float:
        """The share of its speed that it keeps however far its nose is off: wheels that steer must roll."""
        return 0.4 if self.turning_radius else 0.0

    def _turning(self, speed: float) -> float:
        if not self.turning_radius:
            return self.limits.yaw_rate
        return min(self.limits.yaw_rate, speed / self.turning_radius)
