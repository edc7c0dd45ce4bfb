"""Motor and gear of a servo: torque, inertia, back EMF, current, temperature, and voltage sag.

Angles in rad, speeds in rad/s, torques in N m, currents in A, temperatures in degrees Celsius.
"""

from __future__ import annotations

from msgspec import Struct

from lfield_sim.dynamixel.servo_model import MotorStrength

AMBIENT = 25.0
#: Seconds from rest to full speed at stall torque, which defines the inertia.
SPIN_UP = 0.05
#: Seconds to coast to rest, braked by the gear.
COAST = 0.04
#: Heating at stall current in degrees per second, and the time constant of cooling in seconds.
HEATING, COOLING = 1.2, 120.0
#: Cables and supply, in ohms.
RESISTANCE = 0.3


class ServoMotor(Struct):
    """The rotating parts. `load` is an external torque against positive motion.

    `blocked`: the shaft is held externally; `slipping`: the motor turns without the shaft. `sag` is a voltage
    drop of the supply, `heater` an external heating in degrees per second.
    """

    strength: MotorStrength
    angle: float = 0.0
    speed: float = 0.0
    current: float = 0.0
    duty: float = 0.0
    temperature: float = AMBIENT + 5.0
    load: float = 0.0
    blocked: bool = False
    slipping: bool = False
    sag: float = 0.0
    heater: float = 0.0
    _obstacle: float | None = None
    _side: float = 1.0

    def set_obstacle(self, angle: float | None) -> None:
        """Places an obstacle at an angle, on the other side of the shaft; None removes it."""
        if angle != self._obstacle:
            self._obstacle = angle
            self._side = 1.0 if angle is None or self.angle >= angle else -1.0

    @property
    def voltage(self) -> float:
        """Voltage at the terminals."""
        return max(0.0, self.strength.voltage - self.sag - RESISTANCE * abs(self.current))

    @property
    def inertia(self) -> float:
        """Inertia of motor and gear, in kg m2."""
        return self.strength.stall_torque * SPIN_UP / self.strength.fastest

    @property
    def max_acceleration(self) -> float:
        """The guaranteed acceleration for controllers, in rad/s2."""
        return 0.6 * self.strength.fastest / SPIN_UP

    def torque_at(self, duty: float) -> float:
        """The torque at the present speed for a share of the supply, -1 to 1."""
        push = duty * self.voltage / self.strength.voltage
        return self.strength.stall_torque * (push - self.speed / self.strength.fastest)

    def torque_for(self, speed: float, dt: float) -> float:
        """The torque for a speed `dt` from now."""
        return self.inertia * (speed - self.speed) / dt + self.load

    def step_unpowered(self, dt: float) -> None:
        """Advances `dt` seconds without power."""
        self.current = self.duty = 0.0
        self.speed *= max(0.0, 1.0 - dt / COAST)
        if abs(self.speed) < 1e-4:
            self.speed = 0.0
        self._turn(dt)
        self._heat(dt)

    def drive(self, torque: float, duty: float, current: float, dt: float) -> None:
        """Advances `dt` seconds with a torque, limited by a share of the supply and a current."""
        strength, per_ampere = self.strength, self.strength.stall_torque / self.strength.stall_current
        low, high = self.torque_at(-duty), self.torque_at(duty)
        low, high = max(low, -current * per_ampere), min(high, current * per_ampere)
        applied = max(low, min(high, torque)) if low <= high else 0.0
        self.current = applied / per_ampere
        push = applied / strength.stall_torque + self.speed / strength.fastest
        self.duty = max(-1.0, min(1.0, push * strength.voltage / max(1.0, self.voltage)))
        self.speed += (applied - self.load) / self.inertia * dt
        self._turn(dt)
        self._heat(dt)

    def _turn(self, dt: float) -> None:
        if self.blocked or self.slipping:
            self.speed = 0.0
            if self.slipping:
                self.current *= 0.1
        self.angle += self.speed * dt
        if self._obstacle is not None and (self.angle - self._obstacle) * self._side < 0.0:
            self.angle, self.speed = self._obstacle, 0.0

    def _heat(self, dt: float) -> None:
        share = self.current / self.strength.stall_current
        self.temperature += (HEATING * share * share + self.heater) * dt
        self.temperature += (AMBIENT - self.temperature) * min(1.0, dt / COOLING)
