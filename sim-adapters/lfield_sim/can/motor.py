"""A motor with its load: torque in, motion, heat and current out; and a reference that it can be led by.

SI units, at the output shaft; a reference has the units of who leads it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Still air and the fault `overheat`, in degrees Celsius.
AMBIENT, OVERHEATED = 25.0, 130.0
#: Warming at rated current when it runs for long, in kelvin, and how fast that comes, in seconds.
RATED_WARMING, WARMING_TIME = 40.0, 120.0
#: Dry friction of a motor without power, by its rated torque: it runs out, and comes to a stand in the end.
DRY = 0.005


@dataclass(frozen=True, slots=True)
class MotorData:
    """A motor as its data sheet has it; `load` is a constant torque against positive motion (a weight)."""

    inertia: float = 0.01
    friction: float = 0.002
    load: float = 0.0
    rated_torque: float = 1.0
    max_torque: float = 3.0
    torque_constant: float = 0.2
    max_speed: float = 314.0
    supply: float = 48.0
    resistance: float = 0.1
    brake: bool = False


class Motor:
    """What a motor does in time. A brake, if there is one, holds it whenever it is not driven."""

    def __init__(self, data: MotorData) -> None:
        self.data = data
        self.angle = self.speed = self.torque = 0.0
        self.stuck = self.overheated = False
        self._warmth = AMBIENT

    @property
    def temperature(self) -> float:
        """Of the winding, in degrees Celsius."""
        return OVERHEATED if self.overheated else self._warmth

    @property
    def current(self) -> float:
        """The current that makes the torque, in amperes."""
        return self.torque / self.data.torque_constant

    @property
    def supply_current(self) -> float:
        """What it draws from (or feeds back into) the supply, in amperes."""
        heat = self.current * self.current * self.data.resistance
        return (self.torque * self.speed + heat) / self.data.supply

    @property
    def voltage(self) -> float:
        """The supply at its terminals: it sags a little, in volts."""
        return self.data.supply - 0.05 * self.supply_current

    def track(self, speed: float, dt: float, limit: float) -> None:
        """Drive with the torque that reaches `speed` after this step, as far as `limit` allows."""
        needed = self.data.inertia * (speed - self.speed) / dt + self._resisting(speed)
        self.drive(max(-limit, min(limit, needed)), dt)

    def drive(self, torque: float, dt: float) -> None:
        """Let a torque act."""
        self.torque = torque
        self._move((torque - self._resisting(self.speed)) / self.data.inertia, dt)

    def rest(self, dt: float) -> None:
        """Without power: the brake stops and holds it; without a brake it coasts and its load moves it."""
        self.torque = 0.0
        if self.data.brake:
            holding, pulled = 2.0 * self.data.max_torque, 0.0
        else:
            holding, pulled = DRY * self.data.rated_torque, -self._resisting(self.speed)
        most = holding / self.data.inertia * dt
        free = self.speed + pulled / self.data.inertia * dt
        self._move((free - max(-most, min(most, free)) - self.speed) / dt, dt)

    def _resisting(self, speed: float) -> float:
        return self.data.load + self.data.friction * speed

    def _move(self, acceleration: float, dt: float) -> None:
        top = self.data.max_speed
        self.speed = 0.0 if self.stuck else max(-top, min(top, self.speed + acceleration * dt))
        self.angle += self.speed * dt
        rated = self.data.rated_torque / self.data.torque_constant
        aim = AMBIENT + RATED_WARMING * (self.current / rated) ** 2
        self._warmth += (aim - self._warmth) * dt / WARMING_TIME


@dataclass(slots=True)
class Trajectory:
    """Where a reference is and how fast it moves, as a trapezoid: bounded acceleration, no overshoot."""

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
