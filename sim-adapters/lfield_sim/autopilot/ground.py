"""How a rover moves: as a vehicle with a nose that it drives after, on wheels that steer or by its skids."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lfield_sim.autopilot.body.goals import ZERO, Goal, Keep, Reach, Rest, Roll, Vector
from lfield_sim.autopilot.vehicle import Vehicle, eased, wrap

#: The speed in m/s down to which one brakes that brakes before it turns back.
TURNS = 0.3
#: How far off its nose may be when a skid steered rover sets out for a place, in rad.
PIVOTS = math.radians(10.0)
#: m/s2 by which an overshoot goes back; m/s2 that rolling takes beside the share of the speed.
SETTLES, FRICTION = 0.2, 0.02
#: m/s from which on the speed to a place is not overshot: 2 and 3 are, 5 is not (ap-rover.c-speed).
SHOOTS = 4.0


@dataclass(frozen=True, slots=True)
class Wheels:
    """How a rover comes round, and to a stop at a place.

    `radius` in m is that of its tightest circle (Ackermann): such a one turns only as it drives. 0 is skid
    steering, which turns on the spot. `tight` is how fast it takes that circle, in m/s. What is faster than
    `brakes`, in m/s, brakes on straight before it turns back for a place behind it. It stops within `arrives`
    metres of a place; one that `returns` drives round for a place that it has just passed.
    """

    radius: float = 0.0
    tight: float = 1.6
    brakes: float = 1.9
    arrives: float = 0.05
    returns: bool = False


@dataclass(slots=True)
class GroundVehicle(Vehicle):
    """A rover: it drives where its nose points, and turns to point where it must go."""

    wheels: Wheels = field(default_factory=Wheels)
    _turns_back: bool = False
    _excess: float = 0.0

    @property
    def airborne(self) -> bool:
        """Never."""
        return False

    def released(self) -> Goal:
        """It rolls out, or stands at once."""
        return Roll() if self.limits.rolls_out else Rest()

    def switch_off(self) -> None:
        """The motor goes off."""
        if not self.limits.rolls_out:
            self.settle()
        self.goal, self.yaw_rate_goal = self.released(), None

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        before, heading = self.velocity, self.yaw
        north, east, _ = self._kept_in(self._wanted())
        wanted, along = math.hypot(north, east), math.hypot(*before[:2])
        course = math.atan2(east, north) if wanted > 1e-3 else self.yaw_goal
        if self._brakes_first(course, along):
            wanted, course = 0.0, None
        turn = self._turning(along) * dt
        if self.yaw_rate_goal is not None:
            # Told how fast to turn, it drives on with its nose as it is.
            self.yaw = wrap(self.yaw + max(-turn, min(turn, self.yaw_rate_goal * dt)))
        elif course is not None:
            self.yaw = wrap(self.yaw + max(-turn, min(turn, wrap(course - self.yaw))))
            wanted = self._turning_speed(wanted, abs(wrap(course - self.yaw)))
        wanted += self._overshoot(wanted, along, dt)
        self.yaw_rate = wrap(self.yaw - heading) / dt
        limits = self.limits
        felt = math.copysign(math.hypot(*self.acceleration[:2]), self._pushing)
        (push, _) = eased((felt, 0.0), (wanted - along, 0.0), limits.acceleration, limits.jerk, dt)
        if isinstance(self.goal, Roll):
            push = -self.limits.rolls_out * along - FRICTION
        speed = max(0.0, along + push * dt)
        self.velocity = (speed * math.cos(self.yaw), speed * math.sin(self.yaw), 0.0)
        self.place = (self.place[0] + self.velocity[0] * dt, self.place[1] + self.velocity[1] * dt, 0.0)
        self.acceleration = (push * math.cos(self.yaw), push * math.sin(self.yaw), 0.0)

    def _approach(self, place: Vector) -> Vector:
        """As a copter; but wheels that steer may not turn back for a place that they have just passed."""
        north, east = place[0] - self.place[0], place[1] - self.place[1]
        far = math.hypot(north, east)
        behind = math.cos(math.atan2(east, north) - self.yaw) < 0.0
        passed = behind and not self.wheels.returns and far < 2.0 * self.wheels.radius
        if far < self.wheels.arrives or passed:
            return ZERO
        return Vehicle._approach(self, place)

    @property
    def _pushing(self) -> float:
        """Positive while it speeds up, negative while it slows down."""
        north, east, _ = self.acceleration
        return north * math.cos(self.yaw) + east * math.sin(self.yaw)

    def _turning_speed(self, wanted: float, off: float) -> float:
        """How fast it drives while its nose is off: by its skids it turns first for a place."""
        if self.wheels.radius:
            return max(min(wanted, self.wheels.tight), wanted * math.cos(off))
        return 0.0 if isinstance(self.goal, Reach) and off > PIVOTS else wanted * max(0.0, math.cos(off))

    def _brakes_first(self, course: float | None, along: float) -> bool:
        """Whether it still brakes straight on because the place that it is to go to is behind it."""
        behind = isinstance(self.goal, Reach) and course is not None and abs(wrap(course - self.yaw)) > 1.6
        self._turns_back = behind and along > (TURNS if self._turns_back else self.wheels.brakes)
        return self._turns_back

    def _overshoot(self, wanted: float, along: float, dt: float) -> float:
        """By how much it is faster than it should be: after speeding up, for a while."""
        most = self._most_overshoot(wanted)
        if not most:
            self._excess = 0.0
        elif wanted - along > 0.5:
            self._excess = most
        elif along > wanted:
            self._excess = max(0.0, self._excess - SETTLES * dt)
        return self._excess

    def _most_overshoot(self, wanted: float) -> float:
        """Over a velocity, and over a slow speed to a place that was commanded."""
        limits = self.limits
        if isinstance(self.goal, Keep):
            return limits.overshoot
        at_cruise = limits.shoots_over and 0.99 * limits.cruise < wanted < SHOOTS
        return limits.overshoot_share * wanted**2 if at_cruise and isinstance(self.goal, Reach) else 0.0

    def _turning(self, speed: float) -> float:
        if not self.wheels.radius:
            return self.limits.yaw_rate
        return min(self.limits.yaw_rate, speed / self.wheels.radius)
