"""Motion of a rover with steered wheels or skid steering."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from msgspec import Struct

from lfield_sim.autopilot.body.goals import ZERO, Goal, Keep, Reach, Rest, Roll, Vector
from lfield_sim.autopilot.vehicle import Vehicle, eased, wrap

#: Speed in m/s down to which a rover brakes before it turns back.
TURNS = 0.3
#: Heading error up to which a skid-steered rover starts to a position, in rad.
PIVOTS = math.radians(10.0)
#: Deceleration after an overshoot, m/s2; friction in m/s2 in addition to a share of the speed.
SETTLES, FRICTION = 0.2, 0.02
#: m/s above which the speed to a position is not overshot: 2 and 3 are, 5 is not (ap-rover.c-speed).
SHOOTS = 4.0


class Wheels(Struct, frozen=True):
    """The steering and stopping of a rover at a position.

    `radius` in m is that of the tightest circle (Ackermann), which a rover turns only while driving; 0 is
    skid steering, which turns on the spot. `tight` is the speed on that circle in m/s. Above `brakes` in m/s
    a rover brakes straight before it turns back to a position behind it. It stops within `arrives` metres of
    a position; a rover that `returns` drives round to a position that it has just passed.
    """

    radius: float = 0.0
    tight: float = 1.6
    brakes: float = 1.9
    arrives: float = 0.05
    returns: bool = False


@dataclass(slots=True)
class GroundVehicle(Vehicle):
    """A rover: it drives along its heading, and turns towards its goal."""

    wheels: Wheels = field(default_factory=Wheels)
    _turns_back: bool = False
    _excess: float = 0.0

    @property
    def airborne(self) -> bool:
        """Always False."""
        return False

    def released(self) -> Goal:
        """The goal without a drive: the rover rolls out, or stops at once."""
        return Roll() if self.limits.rolls_out else Rest()

    def switch_off(self) -> None:
        """Switches the motor off."""
        if not self.limits.rolls_out:
            self.settle()
        self.goal, self.yaw_rate_goal = self.released(), None

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        before, heading = self.velocity, self.yaw
        north, east, _ = self._fenced(self._target_velocity())
        north, east = north * self.ground, east * self.ground
        target_speed, along = math.hypot(north, east), math.hypot(*before[:2])
        course = math.atan2(east, north) if target_speed > 1e-3 else self.yaw_goal
        if self._brakes_first(course, along):
            target_speed, course = 0.0, None
        turn = self._turning(along) * dt
        if self.yaw_rate_goal is not None:
            # With a yaw rate a rover keeps its speed along its heading.
            self.yaw = wrap(self.yaw + max(-turn, min(turn, self.yaw_rate_goal * dt)))
        elif course is not None:
            self.yaw = wrap(self.yaw + max(-turn, min(turn, wrap(course - self.yaw))))
            target_speed = self._turning_speed(target_speed, abs(wrap(course - self.yaw)))
        target_speed += self._overshoot(target_speed, along, dt)
        self.yaw_rate = wrap(self.yaw - heading) / dt
        limits = self.limits
        present = math.copysign(math.hypot(*self.acceleration[:2]), self._forward_acceleration)
        (acceleration, _) = eased(
            (present, 0.0), (target_speed - along, 0.0), limits.acceleration, limits.jerk, dt
        )
        if isinstance(self.goal, Roll):
            acceleration = -self.limits.rolls_out * along - FRICTION
        speed = max(0.0, along + acceleration * dt)
        self.velocity = (speed * math.cos(self.yaw), speed * math.sin(self.yaw), 0.0)
        self.place = (self.place[0] + self.velocity[0] * dt, self.place[1] + self.velocity[1] * dt, 0.0)
        self.acceleration = (acceleration * math.cos(self.yaw), acceleration * math.sin(self.yaw), 0.0)

    def _approach(self, place: Vector) -> Vector:
        """The velocity to a position, as of a copter; steered wheels may not turn back to a position just
        passed.
        """
        north, east = place[0] - self.place[0], place[1] - self.place[1]
        distance = math.hypot(north, east)
        behind = math.cos(math.atan2(east, north) - self.yaw) < 0.0
        passed = behind and not self.wheels.returns and distance < 2.0 * self.wheels.radius
        if distance < self.wheels.arrives or passed:
            return ZERO
        return Vehicle._approach(self, place)

    @property
    def _forward_acceleration(self) -> float:
        """Positive while it accelerates, negative while it decelerates."""
        north, east, _ = self.acceleration
        return north * math.cos(self.yaw) + east * math.sin(self.yaw)

    def _turning_speed(self, target: float, heading_error: float) -> float:
        """The speed with a heading error: a skid-steered rover turns first."""
        if self.wheels.radius:
            return max(min(target, self.wheels.tight), target * math.cos(heading_error))
        pivots = isinstance(self.goal, Reach) and heading_error > PIVOTS
        return 0.0 if pivots else target * max(0.0, math.cos(heading_error))

    def _brakes_first(self, course: float | None, along: float) -> bool:
        """Whether the rover still brakes straight because its goal is behind it."""
        behind = isinstance(self.goal, Reach) and course is not None and abs(wrap(course - self.yaw)) > 1.6
        self._turns_back = behind and along > (TURNS if self._turns_back else self.wheels.brakes)
        return self._turns_back

    def _overshoot(self, target: float, along: float, dt: float) -> float:
        """The excess over the target speed for a while after an acceleration."""
        overshoot = self._max_overshoot(target)
        if not overshoot:
            self._excess = 0.0
        elif target - along > 0.5:
            self._excess = overshoot
        elif along > target:
            self._excess = max(0.0, self._excess - SETTLES * dt)
        return self._excess

    def _max_overshoot(self, target: float) -> float:
        """The overshoot of a velocity, and of a slow commanded speed to a position."""
        limits = self.limits
        if isinstance(self.goal, Keep):
            return limits.overshoot
        at_cruise = limits.shoots_over and 0.99 * limits.cruise < target < SHOOTS
        return limits.overshoot_share * target**2 if at_cruise and isinstance(self.goal, Reach) else 0.0

    def _turning(self, speed: float) -> float:
        if not self.wheels.radius:
            return self.limits.yaw_rate
        return min(self.limits.yaw_rate, speed / self.wheels.radius)
