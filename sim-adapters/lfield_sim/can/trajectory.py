"""A reference that moves as a trapezoid: bounded speed, bounded acceleration, no overshoot. Any units."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(slots=True)
class Trajectory:
    """Where the reference is and how fast it moves."""

    position: float = 0.0
    velocity: float = 0.0

    def to_position(
        self, target: float, *, speed: float, acceleration: float, deceleration: float, dt: float
    ) -> None:
        """One step towards a position, stopping there."""
        distance = target - self.position
        brake = deceleration * dt
        # The fastest speed at which one can still stop after this step.
        braking = math.sqrt(brake * brake + 2.0 * deceleration * abs(distance)) - brake
        self._change(math.copysign(min(speed, braking), distance), acceleration, deceleration, dt)
        if abs(target - self.position) <= brake * dt and abs(self.velocity) <= brake:
            self.position, self.velocity = target, 0.0

    def to_velocity(self, target: float, *, acceleration: float, deceleration: float, dt: float) -> None:
        """One step towards a velocity."""
        self._change(target, acceleration, deceleration, dt)

    def _change(self, wanted: float, acceleration: float, deceleration: float, dt: float) -> None:
        faster = wanted * self.velocity >= 0.0 and abs(wanted) > abs(self.velocity)
        most = (acceleration if faster else deceleration) * dt
        self.velocity += max(-most, min(most, wanted - self.velocity))
        self.position += self.velocity * dt
