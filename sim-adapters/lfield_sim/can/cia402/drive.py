"""What the motor of a CiA 402 drive can be told, and where it is, in units of its objects. Pure.

Positions are increments as they count now, velocities increments per second, torques newton metres.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from lfield_sim.can.canopen.sdo import ObjectDictionary
from lfield_sim.can.motor import Motor, Trajectory

#: An error code (0x603F) with its bits in the error register (0x1001).
Trouble = tuple[int, int]
FOLLOWING, BLOCKED = (0x8611, 0x20), (0x7121, 0x20)
#: A motor that does not turn at its full torque is blocked after this long, in seconds.
BLOCKED_FOR = 0.5
#: The gain of the position loop in 1/s.
GAIN = 20.0
#: The home switch is this far below where the drive wakes up, in radians.
HOME_BELOW = math.pi
_HALT = 0x100


class Drive:
    """A motor with its reference (`profile`), bounded by the objects. `fail` hears what goes wrong.

    `word` is the controlword, of which modes have their bits; `torque_demand` what is asked of the motor.
    """

    def __init__(self, objects: ObjectDictionary, motor: Motor, fail: Callable[[Trouble], None]) -> None:
        self.objects, self.motor, self._fail = objects, motor, fail
        self.home = motor.angle - HOME_BELOW
        #: Increments per radian.
        self.scale = objects.get(0x608F, 1) / math.tau
        self.reset()

    def reset(self) -> None:
        """As after power-up: the encoder counts from where the motor stands."""
        self.profile = Trajectory()
        self.word = 0
        self.origin = self.motor.angle
        self.torque_demand = 0.0
        self.watch_anew()

    def watch_anew(self) -> None:
        """Forget for how long it has been off its track or blocked."""
        self._off_track = self._blocked = 0.0

    # -- where it is, and its bounds ------------------------------------------------------------------

    @property
    def position(self) -> float:
        """Where the motor is, in increments."""
        return (self.motor.angle - self.origin) * self.scale

    @property
    def velocity(self) -> float:
        """How fast it turns, in increments per second."""
        return self.motor.speed * self.scale

    @property
    def halted(self) -> bool:
        """Whether the controlword asks for a halt."""
        return bool(self.word & _HALT)

    @property
    def fastest(self) -> float:
        """The bound on every speed, in increments per second."""
        top = self.objects.get(0x6080) / 60.0 * math.tau * self.scale
        return min(top, self.objects.get(0x607F), self.motor.data.max_speed * self.scale)

    @property
    def strongest(self) -> float:
        """The bound on every torque, in newton metres."""
        share = min(self.objects.get(index) for index in (0x6072, 0x6073, 0x60E0, 0x60E1))
        return min(share / 1000.0 * self.motor.data.rated_torque, self.motor.data.max_torque)

    @property
    def home_position(self) -> float:
        """Where the home switch is, in increments as they count now."""
        return (self.home - self.origin) * self.scale

    def within(self, target: float) -> float:
        """A target position inside the software limits (0x607D), if there are any."""
        low, high = self.objects.get(0x607D, 1), self.objects.get(0x607D, 2)
        return max(low, min(high, target)) if low < high else target

    # -- what it can be told --------------------------------------------------------------------------

    def follow(self, dt: float) -> None:
        """Drive the motor after the reference position, and watch how far it stays behind."""
        error = self.profile.position - self.position
        self.motor.track((self.profile.velocity + GAIN * error) / self.scale, dt, self.strongest)
        behind = abs(error) > self.objects.get(0x6065)
        self._off_track = self._off_track + dt if behind else 0.0
        if self._off_track > self.objects.get(0x6066) / 1000.0:
            self._fail(FOLLOWING)

    def ramp(self, velocity: float, dt: float, *, acceleration: float, deceleration: float) -> None:
        """Drive the motor after a reference velocity; the reference position goes with the motor."""
        self.profile.to_velocity(velocity, acceleration=acceleration, deceleration=deceleration, dt=dt)
        self.motor.track(self.profile.velocity / self.scale, dt, self.strongest)
        self.profile.position = self.position
        blocked = self.motor.speed == 0.0 and abs(self.motor.torque) >= self.strongest > 0.0
        self._blocked = self._blocked + dt if blocked else 0.0
        if self._blocked > BLOCKED_FOR:
            self._fail(BLOCKED)

    def brake(self, dt: float, *, deceleration: float) -> None:
        """Ramp down to rest, and stay there."""
        self.ramp(0.0, dt, acceleration=deceleration, deceleration=deceleration)

    def stop(self, dt: float, option: int) -> None:
        """Brake as an option code says (0x605A, 0x605D, 0x605E), but 0.

        1 and 5 are the slow down ramp, 2 and 6 the quick stop ramp; the others all the torque there is.
        """
        ramps = {1: 0x6084, 5: 0x6084, 2: 0x6085, 6: 0x6085}
        self.brake(dt, deceleration=self.objects.get(ramps[option]) if option in ramps else math.inf)

    def halt(self, dt: float) -> None:
        """Brake as the halt option code says, and stay in operation."""
        self.stop(dt, self.objects.get(0x605D))

    def rest(self, dt: float) -> None:
        """No power: the reference goes with the motor."""
        self.motor.rest(dt)
        self.profile = Trajectory(self.position)

    def take_over(self) -> None:
        """Let the reference begin where the motor is, as fast as it turns."""
        self.profile = Trajectory(self.position, self.velocity)

    def set_position(self, increments: float) -> None:
        """Let the place where the motor stands be this one (homing)."""
        self.origin = self.motor.angle - increments / self.scale
        self.profile = Trajectory(increments)
