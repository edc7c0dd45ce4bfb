"""Motor control of a CiA 402 drive, in units of its objects. Pure.

Positions are increments, velocities increments per second, torques newton metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield_sim.can.can_motor import CanMotor, Trajectory
from lfield_sim.can.canopen.sdo import ObjectDictionary

#: An error code (0x603F) with its bits in the error register (0x1001).
DriveError = tuple[int, int]
FOLLOWING, BLOCKED = (0x8611, 0x20), (0x7121, 0x20)
#: Seconds at full torque without motion after which a motor is blocked.
BLOCKED_FOR = 0.5
#: The gain of the position loop in 1/s.
GAIN = 20.0
#: Distance of the home switch below the power-up position, in radians.
HOME_BELOW = math.pi
_HALT = 0x100


class Cia402Drive:
    """A motor with its reference (`profile`), bounded by the objects. `fail` gets errors.

    `controlword` includes the mode-specific bits; `torque_demand` is the commanded torque.
    """

    def __init__(
        self, objects: ObjectDictionary, motor: CanMotor, fail: Callable[[DriveError], None]
    ) -> None:
        self.objects, self.motor, self._fail = objects, motor, fail
        self.home = motor.angle - HOME_BELOW
        #: Increments per radian.
        self.scale = objects.get(0x608F, 1) / math.tau
        self.reset()

    def reset(self) -> None:
        """Power-up: the encoder counts from the present position."""
        self.profile = Trajectory()
        self.controlword = 0
        self.origin = self.motor.angle
        self.torque_demand = 0.0
        self.reset_monitoring()

    def reset_monitoring(self) -> None:
        """Resets the durations of following error and blocking."""
        self._off_track = self._blocked = 0.0

    # -- position and bounds --------------------------------------------------------------------------

    @property
    def position(self) -> float:
        """The position of the motor, in increments."""
        return (self.motor.angle - self.origin) * self.scale

    @property
    def velocity(self) -> float:
        """The velocity of the motor, in increments per second."""
        return self.motor.speed * self.scale

    @property
    def halted(self) -> bool:
        """Whether the controlword requests a halt."""
        return bool(self.controlword & _HALT)

    @property
    def fastest(self) -> float:
        """The limit of every speed, in increments per second."""
        top = self.objects.get(0x6080) / 60.0 * math.tau * self.scale
        return min(top, self.objects.get(0x607F), self.motor.data.max_speed * self.scale)

    @property
    def strongest(self) -> float:
        """The limit of every torque, in newton metres."""
        share = min(self.objects.get(index) for index in (0x6072, 0x6073, 0x60E0, 0x60E1))
        return min(share / 1000.0 * self.motor.data.rated_torque, self.motor.data.max_torque)

    @property
    def home_position(self) -> float:
        """Position of the home switch, in increments."""
        return (self.home - self.origin) * self.scale

    def within(self, target: float) -> float:
        """A target position within the software limits (0x607D), if any."""
        low, high = self.objects.get(0x607D, 1), self.objects.get(0x607D, 2)
        return max(low, min(high, target)) if low < high else target

    # -- control --------------------------------------------------------------------------------------

    def follow(self, dt: float) -> None:
        """Drives the motor to the reference position, and monitors the following error."""
        error = self.profile.position - self.position
        self.motor.track((self.profile.velocity + GAIN * error) / self.scale, dt, self.strongest)
        is_behind = abs(error) > self.objects.get(0x6065)
        self._off_track = self._off_track + dt if is_behind else 0.0
        if self._off_track > self.objects.get(0x6066) / 1000.0:
            self._fail(FOLLOWING)

    def ramp(self, velocity: float, dt: float, *, acceleration: float, deceleration: float) -> None:
        """Drives the motor to a reference velocity; the reference position follows the motor."""
        self.profile.to_velocity(velocity, acceleration=acceleration, deceleration=deceleration, dt=dt)
        self.motor.track(self.profile.velocity / self.scale, dt, self.strongest)
        self.profile.position = self.position
        blocked = self.motor.speed == 0.0 and abs(self.motor.torque) >= self.strongest > 0.0
        self._blocked = self._blocked + dt if blocked else 0.0
        if self._blocked > BLOCKED_FOR:
            self._fail(BLOCKED)

    def brake(self, dt: float, *, deceleration: float) -> None:
        """Ramps down to rest, and stays there."""
        self.ramp(0.0, dt, acceleration=deceleration, deceleration=deceleration)

    def stop(self, dt: float, option: int) -> None:
        """Brakes by an option code (0x605A, 0x605D, 0x605E) other than 0.

        1 and 5 are the slow down ramp, 2 and 6 the quick stop ramp; others use maximum torque.
        """
        ramps = {1: 0x6084, 5: 0x6084, 2: 0x6085, 6: 0x6085}
        self.brake(dt, deceleration=self.objects.get(ramps[option]) if option in ramps else math.inf)

    def halt(self, dt: float) -> None:
        """Brakes by the halt option code, and stays in operation."""
        self.stop(dt, self.objects.get(0x605D))

    def step_unpowered(self, dt: float) -> None:
        """Removes the power: the reference follows the motor."""
        self.motor.step_unpowered(dt)
        self.profile = Trajectory(self.position)

    def take_over(self) -> None:
        """Starts the reference at the motor's position and speed."""
        self.profile = Trajectory(self.position, self.velocity)

    def set_position(self, increments: float) -> None:
        """Defines the present position (homing)."""
        self.origin = self.motor.angle - increments / self.scale
        self.profile = Trajectory(increments)
