"""Motion of a vehicle: point kinematics with limits on speed and acceleration. No protocol, no modes.

Local frame: metres north, east, down from the place of power-on; the ground is flat at down = 0. Angles in
radians, yaw clockwise from north.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from msgspec import Struct

from lfield_sim.autopilot.body.goals import (
    ZERO,
    Descend,
    Fall,
    Goal,
    Keep,
    Lean,
    Orbit,
    Reach,
    Rest,
    Rise,
    Sink,
    Track,
    Vector,
)
from lfield_sim.autopilot.wind import GRAVITY, Wind

#: Metres above the ground that count as airborne.
AIRBORNE = 0.05
#: Metres to a position within which the heading is kept.
NEAR = 3.0
#: Remaining deceleration in m/s2 when a vehicle eases to a stop.
STILL = 0.05
#: Per second: PX4's speed per metre to a setpoint (MPC_XY_P, MPC_Z_P).
LEVEL_GAIN, HEIGHT_GAIN = 0.95, 1.0
#: Seconds in which a copter without enough power reaches two thirds of its sink rate.
SLUGGISH = 1.5
#: Descent of a copter with its throttle down, in m/s.
SINK = 2.5


class Response(Struct, frozen=True):
    """The actual speed for a commanded one: a factor, and an offset in m/s."""

    gain: float = 1.0
    offset: float = 0.0

    def flown(self, speed: float) -> float:
        """The actual speed for a commanded one; zero stays zero."""
        return speed * self.gain + self.offset if speed > 0.0 else 0.0


class Limits(Struct):
    """Speeds in m/s, accelerations in m/s2, jerk in m/s3, yaw rate in rad/s, tilt in rad.

    `cruise` bounds the speed to a position, `top` all horizontal speeds; `braking` is its deceleration before
    a position. `eases` is the time constant in seconds in which a copter approaches a velocity, or stops in a
    hold. `spool` are the seconds until motors lift it, `awake` those from arming, `lift` its acceleration
    from the ground (m/s2), `takeoff` its climb afterwards. `nose_follows` turns the heading along a velocity.
    `overshoot` is a rover's overshoot of a velocity (m/s); for a speed to a position it is `overshoot_share`
    (s/m) of the square of that while it `shoots_over`; `rolls_out` is the share of its speed that it loses
    per second undriven, 0 for an immediate stop. `goal_response` and `velocity_response` map commanded to
    actual speeds, for positions and velocities. `sets_out` is the share that a copter flies at first; it
    makes up two thirds of the rest in `learns` seconds, by integral control.
    """

    cruise: float = 5.0
    top: float = 100.0
    climb: float = 2.5
    descend: float = 1.5
    land: float = 1.0
    acceleration: float = 2.5
    vertical_acceleration: float = 2.5
    braking: float = 2.5
    jerk: float = 5.0
    tilt: float = math.radians(30.0)
    spool: float = 0.0
    awake: float = 0.0
    lift: float = 2.5
    takeoff: float = 2.5
    yaw_rate: float = math.radians(60.0)
    nose_follows: bool = True
    eases: float = 0.0
    overshoot: float = 0.0
    overshoot_share: float = 0.0
    shoots_over: bool = False
    rolls_out: float = 0.0
    goal_response: Response = Response()
    velocity_response: Response = Response()
    sets_out: float = 1.0
    learns: float = 1.0


class VelocityFence(Struct, frozen=True):
    """A horizontal circle with a radius in m that velocities do not leave."""

    north: float
    east: float
    radius: float


@dataclass(slots=True)
class Vehicle:
    """A copter. `yaw_goal` None turns the heading along its path; `yaw_rate_goal` (rad/s) has priority.

    `ground` is the share of its speed that the ground permits a rover.

    `station` is the position that it returns to after wind has moved it, `sags` its forced sink rate in m/s
    for lack of power.
    """

    limits: Limits = field(default_factory=Limits)
    place: Vector = ZERO
    velocity: Vector = ZERO
    acceleration: Vector = ZERO
    yaw: float = 0.0
    yaw_goal: float | None = None
    yaw_rate_goal: float | None = None
    yaw_rate: float = 0.0
    goal: Goal = field(default_factory=Rest)
    velocity_fence: VelocityFence | None = None
    lifting: bool = True
    wind: Wind = field(default_factory=Wind)
    ground: float = 1.0
    station: tuple[float, float] | None = None
    sags: float = 0.0
    _learned: tuple[float, float] = (0.0, 0.0)

    @property
    def airborne(self) -> bool:
        """Whether the vehicle is off the ground."""
        return self.place[2] < -AIRBORNE

    @property
    def roll(self) -> float:
        """The roll for the present acceleration, against the wind."""
        north, east = self._lean
        return math.atan2(-north * math.sin(self.yaw) + east * math.cos(self.yaw), GRAVITY)

    @property
    def pitch(self) -> float:
        """The pitch, positive with the nose up; accelerating needs it down."""
        north, east = self._lean
        return math.atan2(-(north * math.cos(self.yaw) + east * math.sin(self.yaw)), GRAVITY)

    @property
    def _lean(self) -> tuple[float, float]:
        return (self.acceleration[0] - self.wind.push[0], self.acceleration[1] - self.wind.push[1])

    def released(self) -> Goal:
        """The goal of an armed vehicle without a command: a copter hovers."""
        return Rest()

    def switch_off(self) -> None:
        """Switches the motors off: the vehicle falls, or rests."""
        if self.airborne:
            self.goal = Fall()
        else:
            self.settle()

    def level(self) -> None:
        """Levels the vehicle at once: a new mode starts without horizontal acceleration."""
        self.acceleration = (0.0, 0.0, self.acceleration[2])

    def settle(self) -> None:
        """Puts the vehicle at rest on the ground, with the motors off."""
        self.place, self.velocity, self.acceleration = (*self.place[:2], 0.0), ZERO, ZERO
        self.goal, self.yaw_rate_goal = Rest(), None

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        before, limits = self.velocity, self.limits
        north, east, down = self._fenced(self._stationed(self._set_out(self._target_velocity(), dt)))
        error = (north - before[0], east - before[1])
        present = (self.acceleration[0] - self.wind.residual[0], self.acceleration[1] - self.wind.residual[1])
        # A vehicle that only leans, or falls, moves with the wind.
        self.wind.apply(before, dt, flies=self.airborne, drifts=isinstance(self.goal, Lean | Fall))
        lean = eased(present, error, self._strongest(error), limits.jerk, dt)
        lean = self.wind.actual_acceleration(lean, before, limits.tilt)
        vertical = _towards(before[2], down, self._vertical(down) * dt)
        if self.sags:
            vertical = before[2] + (self.sags - before[2]) * dt / SLUGGISH
        self.velocity = (before[0] + lean[0] * dt, before[1] + lean[1] * dt, vertical)
        self._move(dt)
        self.acceleration = (*lean, (self.velocity[2] - before[2]) / dt)
        heading = self.yaw
        self._turn(dt)
        self.yaw_rate = wrap(self.yaw - heading) / dt

    def _target_velocity(self) -> Vector:
        """The velocity for the goal."""
        match self.goal:
            case Reach(place):
                return self._approach(place)
            case Track(place, velocity):
                return self._tracked(place, velocity)
            case Keep(velocity):
                return self._bounded(velocity)
            case Orbit(centre, radius, speed):
                return self._around(centre, radius, speed)
            case Lean(north, east, down):
                # Leaning one second ahead: the bound on acceleration results in a lean.
                ahead = (self.velocity[0] + north, self.velocity[1] + east)
                return self._bounded((*ahead, down))
            case Rise(down, speed):
                remaining = max(0.0, self.place[2] - down)
                return (0.0, 0.0, -_braking(remaining, speed, self.limits.vertical_acceleration))
            case Sink():
                return (0.0, 0.0, SINK)
            case Descend():
                limits = self.limits
                speed = limits.land if self.place[2] > -10.0 else limits.descend
                return (0.0, 0.0, limits.velocity_response.flown(speed))
            case Fall():
                return (self.velocity[0], self.velocity[1], 50.0)
        return ZERO

    def _set_out(self, target: Vector, dt: float) -> Vector:
        """The actual velocity for a target, initially and with integral control."""
        share, (north, east) = self.limits.sets_out, target[:2]
        if share == 1.0:
            return target
        # The maximum deficit of this velocity, which integral control approaches.
        deficit, gain = 1.0 / share - 1.0, min(1.0, dt / self.limits.learns)
        sums = zip(self._learned, (deficit * north, deficit * east), strict=True)
        learned = tuple(value + gain * (limit - value) for value, limit in sums)
        length, largest = math.hypot(*learned), deficit * math.hypot(north, east)
        scale = min(1.0, largest / length) if length > 0.0 else 1.0
        self._learned = (learned[0] * scale, learned[1] * scale)
        return (share * (north + self._learned[0]), share * (east + self._learned[1]), target[2])

    def _stationed(self, target: Vector) -> Vector:
        """The velocity for a target; in wind, back to the stopping place of a vehicle that is to stay."""
        if not (self.wind.blows and self.airborne and isinstance(self.goal, Rest | Rise | Descend)):
            self.station = None
        elif self.station is None and math.hypot(*self.velocity[:2]) < STILL:
            self.station = self.place[:2]
        if self.station is None:
            return target
        north, east, _ = self._approach((*self.station, self.place[2]))
        return (north, east, target[2])

    @property
    def _nose_follows(self) -> bool:
        """Whether the heading follows the path: on the way to a position that is not near."""
        if isinstance(self.goal, Reach):
            return math.dist(self.place[:2], self.goal.place[:2]) > NEAR
        return self.limits.nose_follows

    def _strongest(self, error: tuple[float, float]) -> float:
        """The maximum horizontal acceleration or deceleration now."""
        if isinstance(self.goal, Lean):
            return math.hypot(self.goal.north, self.goal.east)
        if isinstance(self.goal, Track):
            return GRAVITY * math.tan(self.limits.tilt)
        goal, along = self.goal, sum(m * v for m, v in zip(error, self.velocity, strict=False))
        gains = isinstance(goal, Keep) and along >= 0.0
        eases = goal.eases if isinstance(goal, Rest) else self.limits.eases * gains
        easy = math.hypot(*error) / eases + STILL if eases else math.inf
        return min(self.limits.acceleration, easy)

    def _vertical(self, down: float) -> float:
        """The vertical acceleration; gentle until the vehicle has left the ground at its speed."""
        if isinstance(self.goal, Fall):
            return GRAVITY
        if self.place[2] >= 0.0:
            self.lifting = True
        elif self.velocity[2] <= down + 0.01:
            self.lifting = False
        return self.limits.lift if self.lifting else self.limits.vertical_acceleration

    def _fenced(self, velocity: Vector) -> Vector:
        """A velocity limited so that the vehicle stops inside the fence."""
        if self.velocity_fence is None:
            return velocity
        north, east = self.place[0] - self.velocity_fence.north, self.place[1] - self.velocity_fence.east
        distance = math.hypot(north, east)
        if distance < 1e-6:
            return velocity
        out = (north / distance, east / distance)
        outward = velocity[0] * out[0] + velocity[1] * out[1]
        allowed = _braking(max(0.0, self.velocity_fence.radius - distance), math.inf, self.limits.braking)
        excess = max(0.0, outward - allowed)
        return (velocity[0] - out[0] * excess, velocity[1] - out[1] * excess, velocity[2])

    def _approach(self, place: Vector) -> Vector:
        limits = self.limits
        north, east, down = _minus(place, self.place)
        distance = math.hypot(north, east)
        fastest_level = limits.goal_response.flown(min(limits.cruise, limits.top))
        speed = _braking(distance, fastest_level, limits.braking)
        share = speed / distance if distance > 1e-9 else 0.0
        fastest = limits.descend if down > 0 else limits.climb
        vertical = math.copysign(_braking(abs(down), fastest, limits.vertical_acceleration), down)
        return (north * share, east * share, vertical)

    def _tracked(self, place: Vector, velocity: Vector) -> Vector:
        """The velocity of PX4's position controller, within the maximum speed."""
        gains = (LEVEL_GAIN, LEVEL_GAIN, HEIGHT_GAIN)
        axes = zip(_minus(place, self.place), velocity, gains, strict=True)
        north, east, down = (gain * error + ahead for error, ahead, gain in axes)
        slowly = max(down, -self.limits.takeoff) if self.lifting else down
        return self._bounded((north, east, slowly))

    def _around(self, centre: Vector, radius: float, speed: float) -> Vector:
        """The velocity along the circle, and towards it from outside."""
        north, east, down = _minus(self.place, centre)
        distance = math.hypot(north, east)
        out = (north / distance, east / distance) if distance > 1e-6 else (1.0, 0.0)
        inward = max(-self.limits.cruise, min(self.limits.cruise, radius - distance))
        along = (-out[1] * speed, out[0] * speed)
        return self._bounded((out[0] * inward + along[0], out[1] * inward + along[1], -down))

    def _bounded(self, velocity: Vector) -> Vector:
        north, east, down = velocity
        limits, speed = self.limits, math.hypot(velocity[0], velocity[1])
        share = limits.velocity_response.flown(min(speed, limits.top)) / speed if speed > 0 else 0.0
        return (north * share, east * share, max(-limits.climb, min(limits.descend, down)))

    def _move(self, dt: float) -> None:
        north, east, down = (p + v * dt for p, v in zip(self.place, self.velocity, strict=True))
        if down >= 0.0:
            # The ground ends the motion, unless the vehicle is taking off.
            self.place, self.velocity = (self.place[0], self.place[1], 0.0), ZERO
        else:
            self.place = (north, east, down)

    def _turn(self, dt: float) -> None:
        if self.yaw_rate_goal is not None:
            rate = max(-self.limits.yaw_rate, min(self.limits.yaw_rate, self.yaw_rate_goal))
            self.yaw = wrap(self.yaw + rate * dt)
            return
        goal = self.yaw_goal
        if goal is None and isinstance(self.goal, Orbit) and not self.limits.nose_follows:
            # PX4 faces the centre of its orbit.
            north, east, _ = _minus(self.goal.centre, self.place)
            goal = math.atan2(east, north)
        follows = self._nose_follows
        if goal is None and follows and math.hypot(*self.velocity[:2]) > 0.5 and self.airborne:
            goal = math.atan2(self.velocity[1], self.velocity[0])
        if goal is not None:
            error = wrap(goal - self.yaw)
            self.yaw = wrap(
                self.yaw
                + max(-1.0, min(1.0, error / (self.limits.yaw_rate * dt))) * self.limits.yaw_rate * dt
            )


def wrap(angle: float) -> float:
    """The angle in -pi to pi."""
    return math.remainder(angle, math.tau)


def _minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _braking(distance: float, fastest: float, acceleration: float) -> float:
    """The speed from which a vehicle can stop in `distance`; gentle near the end, so that it settles."""
    return min(fastest, distance * 2.0, math.sqrt(acceleration * distance))


def _towards(value: float, goal: float, change: float) -> float:
    return value + max(-change, min(change, goal - value))


def eased(
    present: tuple[float, ...], error: tuple[float, float], limit: float, jerk: float, dt: float
) -> tuple[float, float]:
    """The next acceleration for a velocity error: at most `limit`, and changed by at most `jerk`.

    The acceleration decreases before the velocity is reached, so that it ends at zero.
    """
    size = math.hypot(*error)
    if size < jerk * dt * dt:
        return (error[0] / dt, error[1] / dt)
    strength = min(limit, math.sqrt(1.6 * jerk * size), size / dt)
    change = (error[0] / size * strength - present[0], error[1] / size * strength - present[1])
    share = min(1.0, jerk * dt / math.hypot(*change)) if any(change) else 0.0
    return (present[0] + change[0] * share, present[1] + change[1] * share)
