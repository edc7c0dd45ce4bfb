"""The units of a CiA 402 drive to and from SI: counts, its unit of velocity, thousandths of rated values."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: How many of each velocity unit are one turn of the motor per second; counts depend on the encoder.
_PER_TURN = {"rpm": 60.0, "milli_rpm": 60_000.0}


@dataclass(slots=True)
class Units:
    """Scales of one drive. `turns` of the motor are one radian of the axis, with its sign.

    `rated_torque` in N m and `rated_current` in A are of the motor; 0 while unknown.
    """

    turns: float
    counts: int
    velocity_unit: str
    rated_torque: float = 0.0
    rated_current: float = 0.0

    def to_counts(self, position: float) -> int:
        """rad of the axis to counts."""
        return round(position * self.turns * self.counts)

    def position(self, counts: int) -> float:
        """Counts to rad of the axis."""
        return counts / self.counts / self.turns

    def to_velocity(self, velocity: float) -> int:
        """rad/s of the axis (or rad/s²) to the drive's unit."""
        return round(velocity * self.turns * self._per_turn)

    def velocity(self, value: int) -> float:
        """The drive's unit to rad/s of the axis."""
        return value / self._per_turn / self.turns

    def to_torque(self, torque: float) -> int:
        """N m of the axis to thousandths of the rated torque, which must be known."""
        return round(1000.0 * torque / self._axis_torque)

    def torque(self, value: int) -> float:
        """Thousandths of the rated torque to N m of the axis."""
        return value / 1000.0 * self._axis_torque

    @property
    def _per_turn(self) -> float:
        return _PER_TURN.get(self.velocity_unit, float(self.counts))

    @property
    def _axis_torque(self) -> float:
        """The rated torque behind the gear, with the sign of the axis; the gear loses nothing."""
        return self.rated_torque * self.turns * math.tau
