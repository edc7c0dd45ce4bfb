"""A motor with its load: torque in, motion, temperature and current out; and a reference for control.

SI units, at the output shaft; a reference has the units of its controller.
"""

from __future__ import annotations

import math

from msgspec import Struct

#: Ambient temperature, and that of the fault `overheat`, in degrees Celsius.
AMBIENT, OVERHEATED = 25.0, 130.0
#: Temperature rise at rated current in kelvin, and its time constant in seconds.
RATED_WARMING, WARMING_TIME = 40.0, 120.0
#: Dry friction of an unpowered motor, relative to its rated torque: it coasts to a stop.
DRY = 0.005


class CanMotorData(Struct, frozen=True):
    """Data sheet of a motor; `load` is a constant torque against positive motion (a weight)."""

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


class CanMotor:
    """A motor over time. A brake, if fitted, holds the motor whenever it is not driven."""

    def __init__(self, data: CanMotorData) -> None:
        self.data = data
        self.angle = self.speed = self.torque = 0.0
        self.stuck = self.overheated = False
        self._temperature = AMBIENT

    @property
    def temperature(self) -> float:
        """Temperature of the winding in degrees Celsius."""
        return OVERHEATED if self.overheated else self._temperature

    @property
    def current(self) -> float:
        """The current for the torque, in amperes."""
        return self.torque / self.data.torque_constant

    @property
    def supply_current(self) -> float:
        """The supply current (negative when it feeds back), in amperes."""
        heat = self.current * self.current * self.data.resistance
        return (self.torque * self.speed + heat) / self.data.supply

    @property
    def voltage(self) -> float:
        """The supply voltage at the terminals, which sags slightly."""
        return self.data.supply - 0.05 * self.supply_current

    def track(self, speed: float, dt: float, limit: float) -> None:
        """Applies the torque that reaches `speed` after this step, within `limit`."""
        needed = self.data.inertia * (speed - self.speed) / dt + self._resisting_torque(speed)
        self.drive(max(-limit, min(limit, needed)), dt)

    def drive(self, torque: float, dt: float) -> None:
        """Applies a torque."""
        self.torque = torque
        self._move((torque - self._resisting_torque(self.speed)) / self.data.inertia, dt)

    def step_unpowered(self, dt: float) -> None:
        """Removes the power: the brake stops and holds the motor; without one it coasts and its load moves
        it.
        """
        self.torque = 0.0
        if self.data.brake:
            holding_torque, load_torque = 2.0 * self.data.max_torque, 0.0
        else:
            holding_torque, load_torque = DRY * self.data.rated_torque, -self._resisting_torque(self.speed)
        max_change = holding_torque / self.data.inertia * dt
        free_speed = self.speed + load_torque / self.data.inertia * dt
        self._move((free_speed - max(-max_change, min(max_change, free_speed)) - self.speed) / dt, dt)

    def _resisting_torque(self, speed: float) -> float:
        return self.data.load + self.data.friction * speed

    def _move(self, acceleration: float, dt: float) -> None:
        top = self.data.max_speed
        self.speed = 0.0 if self.stuck else max(-top, min(top, self.speed + acceleration * dt))
        self.angle += self.speed * dt
        rated = self.data.rated_torque / self.data.torque_constant
        final_temperature = AMBIENT + RATED_WARMING * (self.current / rated) ** 2
        self._temperature += (final_temperature - self._temperature) * dt / WARMING_TIME


class Trajectory(Struct):
    """Position and speed of a trapezoidal reference: bounded acceleration, no overshoot."""

    position: float = 0.0
    velocity: float = 0.0

    def to_position(
        self, target: float, *, speed: float, acceleration: float, deceleration: float, dt: float
    ) -> None:
        """One step towards a position, stopping there."""
        distance = target - self.position
        brake = deceleration * dt
        # The maximum speed from which it can still stop after this step.
        braking = math.sqrt(brake * brake + 2.0 * deceleration * abs(distance)) - brake
        self._change(math.copysign(min(speed, braking), distance), acceleration, deceleration, dt)
        if abs(target - self.position) <= brake * dt and abs(self.velocity) <= brake:
            self.position, self.velocity = target, 0.0

    def to_velocity(self, target: float, *, acceleration: float, deceleration: float, dt: float) -> None:
        """One step towards a velocity."""
        self._change(target, acceleration, deceleration, dt)

    def _change(self, target: float, acceleration: float, deceleration: float, dt: float) -> None:
        accelerates = target * self.velocity >= 0.0 and abs(target) > abs(self.velocity)
        max_change = (acceleration if accelerates else deceleration) * dt
        self.velocity += max(-max_change, min(max_change, target - self.velocity))
        self.position += self.velocity * dt
