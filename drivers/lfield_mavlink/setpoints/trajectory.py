"""Moving targets for setpoints, with bounded speed. Pure.

PX4 does not shape a step of a position setpoint in OFFBOARD: it flies there as fast as MPC_XY_VEL_MAX allows.
So the target itself moves within the permitted speed, and waits when the vehicle falls behind.

PX4's position controller is proportional (MPC_XY_P 0.95, MPC_Z_P 1.0 per second;
https://docs.px4.io/main/en/flight_stack/controller_diagrams): the vehicle follows the target at a distance of
about one second of its speed, and in steady motion has exactly the target's speed in any wind.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

from msgspec import Struct

from lfield_mavlink.geodesy import Vector
from lfield_mavlink.limits import BRAKES
from lfield_mavlink.link.dialect import AUTOPILOT, dialect
from lfield_mavlink.setpoints.speed_correction import SpeedCorrection

# type_mask of SET_POSITION_TARGET_LOCAL_NED: ignores everything but the named fields.
ONLY_POSITION, ONLY_VELOCITY, VELOCITY_AND_YAW_RATE, ONLY_YAW = 0x0DF8, 0x0DC7, 0x05C7, 0x09FF
POSITION_AND_YAW = 0x09F8

#: m/s upwards and downwards; also bounded by the autopilot's parameters (MPC_Z_VEL_MAX_UP, _DN).
CLIMB, SINK = 2.5, 1.5
#: m/s upwards from the ground (MPC_TKO_SPEED).
LIFTS = 1.5
#: Acceleration and deceleration of a target, m/s2.
GAINS, LOSES = 2.5, 4.0
#: Seconds of its speed by which a vehicle follows its target.
FOLLOWS = 1.05
#: The maximum lead of a target: seconds of its speed, and metres. In the last share of it the target slows
#: down to a stop.
LEAD_TIME, LEAD, SLOWS = 1.35, 0.5, 0.1
#: The longest time between two setpoints in which a target moves, in seconds.
LONGEST = 0.2
#: m/s with which a target completes its path.
LEAST = 0.05
#: Metres from a circle within which a target is on it.
ON_CIRCLE = 0.05
#: Deceleration of a rover before its goal, m/s2.
ROVER_BRAKES = 0.8


class Target(Struct, frozen=True):
    """A setpoint in metres of home and m/s; `mask` selects the fields."""

    mask: int
    place: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0

    def message(self, system: int, home: Vector) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED for a system; `home` is in its local frame, in metres."""
        place = (own + home_value for own, home_value in zip(self.place, home, strict=True))
        frame, acceleration = dialect.MAV_FRAME_LOCAL_NED, (0.0, 0.0, 0.0)
        return dialect.MAVLink_set_position_target_local_ned_message(
            0, system, AUTOPILOT, frame, self.mask, *place, *self.velocity, *acceleration,
            self.yaw, self.yaw_rate,
        )  # fmt: skip


class Trajectory(Protocol):
    """A moving target; `speed` is its maximum horizontal speed in m/s, and may be changed."""

    speed: float

    def target(self, now: float, place: Vector | None, velocity: Vector) -> Target:
        """The setpoint at a time in seconds; `place` is the vehicle's position, None if unknown.

        Without a position the target stops. `velocity` is the vehicle's, in m/s.
        """


class _Moving:
    """State of a moving target: position, speed in m/s, and time of the last step."""

    def __init__(self, start: Vector, speed: float, current_speed: float = 0.0) -> None:
        self.speed = speed
        self._point, self._current_speed = start, current_speed
        self._updated_at: float | None = None

    def target(self, now: float, place: Vector | None, velocity: Vector) -> Target:
        """The setpoint, as in Trajectory."""
        elapsed = 0.0 if self._updated_at is None else min(max(0.0, now - self._updated_at), LONGEST)
        self._updated_at = now
        if place is not None:
            self._move(elapsed, self._share(place))
        return self._setpoint()

    def _setpoint(self) -> Target:
        return Target(ONLY_POSITION, self._point)

    def _share(self, place: Vector) -> float:
        """The share of its speed at which the target may move: 0 at maximum lead."""
        level = math.dist(self._point[:2], place[:2]) / (LEAD_TIME * self.speed + LEAD)
        upright = abs(self._point[2] - place[2]) / (LEAD_TIME * CLIMB + LEAD)
        return min(1.0, max(0.0, (1.0 - max(level, upright)) / SLOWS))

    def _move(self, elapsed: float, share: float) -> None:
        raise NotImplementedError

    def _step_to(self, goal: Vector, elapsed: float, share: float, climb: float) -> None:
        """Moves straight to a goal and stops there."""
        offset = tuple(g - p for g, p in zip(goal, self._point, strict=True))
        distance = math.hypot(*offset)
        if distance < 1e-6:
            self._current_speed = 0.0
            return
        horizontal_share, vertical_share = math.hypot(*offset[:2]) / distance, offset[2] / distance
        fastest = min(
            self.speed / horizontal_share if horizontal_share > 1e-6 else math.inf,
            (SINK if vertical_share > 0.0 else climb) / abs(vertical_share)
            if abs(vertical_share) > 1e-6
            else math.inf,
        )
        braking = max(LEAST, math.sqrt(2.0 * LOSES * distance))
        self._current_speed = min(fastest, self._current_speed + GAINS * elapsed, braking)
        step = min(1.0, self._current_speed * share * elapsed / distance)
        north, east, below = (p + w * step for p, w in zip(self._point, offset, strict=True))
        self._point = (north, east, below)


class Leg(_Moving):
    """A straight path to a goal, and a stay there; `yaw` in rad, None to keep it."""

    def __init__(
        self,
        place: Vector,
        velocity: Vector,
        goal: Vector,
        speed: float,
        *,
        climb: float = CLIMB,
        yaw: float | None = None,
    ) -> None:
        start, current_speed = _moving_start(place, velocity, goal)
        super().__init__(start, speed, current_speed)
        self._goal, self._climb, self._yaw = goal, climb, yaw

    def _move(self, elapsed: float, share: float) -> None:
        self._step_to(self._goal, elapsed, share, self._climb)

    def _setpoint(self) -> Target:
        if self._yaw is None:
            return Target(ONLY_POSITION, self._point)
        return Target(POSITION_AND_YAW, self._point, yaw=self._yaw)


class Stay(_Moving):
    """Stays at a position: a stop, or a hover."""

    def __init__(self, place: Vector, speed: float) -> None:
        super().__init__(place, speed)

    def _move(self, elapsed: float, share: float) -> None:
        """Does not move."""


class Ring(_Moving):
    """A path to the nearest point of a circle and round it.

    A following vehicle cuts the circle, so the target uses a larger one that compensates for that. `speed` is
    the target's; the vehicle, on the smaller circle, is not faster.
    """

    def __init__(
        self,
        place: Vector,
        velocity: Vector,
        centre: Vector,
        radius: float,
        speed: float,
        *,
        clockwise: bool,
    ) -> None:
        self._centre, self._radius, self._clockwise = centre, radius, clockwise
        north, east = place[0] - centre[0], place[1] - centre[1]
        self._angle = math.atan2(east, north) if (north or east) else 0.0
        self._is_on_circle = False
        self.speed = speed
        start, current_speed = _moving_start(place, velocity, self._entry)
        super().__init__(start, speed, current_speed)

    @property
    def _entry(self) -> Vector:
        """The point where the target is on, or enters, its circle."""
        lag = (self.speed * FOLLOWS) ** 2
        square = self._radius**2
        target_radius = math.sqrt((square + math.sqrt(square**2 + 4.0 * square * lag)) / 2.0)
        north = self._centre[0] + target_radius * math.cos(self._angle)
        east = self._centre[1] + target_radius * math.sin(self._angle)
        return (north, east, self._centre[2])

    def _move(self, elapsed: float, share: float) -> None:
        entry = self._entry
        if not self._is_on_circle:
            self._step_to(entry, elapsed, share, CLIMB)
            self._is_on_circle = math.dist(self._point, entry) <= ON_CIRCLE
            return
        self._current_speed = min(self.speed, self._current_speed + GAINS * elapsed)
        target_radius = math.dist(entry[:2], self._centre[:2])
        angle = self._current_speed * share * elapsed / target_radius
        self._angle += angle if self._clockwise else -angle
        self._point = self._entry


class Pursuit:
    """A velocity that leads a rover to a goal, slower near it; then it stops.

    Corrected by the actual speed in steady motion.
    """

    def __init__(self, goal: Vector, speed: float, correction: SpeedCorrection) -> None:
        self.speed = speed
        self._goal, self._correction = goal, correction

    def target(self, now: float, place: Vector | None, velocity: Vector) -> Target:
        """The setpoint, as in Trajectory; a rover without a position stops."""
        if place is None:
            return Target(ONLY_VELOCITY)
        north, east = self._goal[0] - place[0], self._goal[1] - place[1]
        distance = math.hypot(north, east)
        if distance < 1e-6:
            return Target(ONLY_VELOCITY)
        braking = math.sqrt(2.0 * ROVER_BRAKES * distance)
        if braking > self.speed:
            self._correction.follow(velocity, (north, east), self.speed, now)
        else:
            self._correction.pause()
        speed = self._correction.commanded(min(self.speed, braking))
        return Target(ONLY_VELOCITY, velocity=(speed * north / distance, speed * east / distance, 0.0))


def _moving_start(place: Vector, velocity: Vector, goal: Vector) -> tuple[Vector, float]:
    """Start of a target for a moving vehicle, and its speed towards the goal.

    The target continues the vehicle's own speed, not beyond the goal.
    """
    offset = tuple(g - p for g, p in zip(goal, place, strict=True))
    distance = math.hypot(*offset)
    if distance < 1e-6:
        return place, 0.0
    speed = max(0.0, sum(w * v for w, v in zip(offset, velocity, strict=True)) / distance)
    share = min(1.0, speed * FOLLOWS / distance)
    north, east, down = (p + w * share for p, w in zip(place, offset, strict=True))
    return (north, east, down), speed


def stopping_place(place: Vector, velocity: Vector) -> Vector:
    """The place where a vehicle would come to rest by braking now, in metres of home.

    To a position behind that place, a car-like rover would drive a loop.
    """
    braking_time = math.hypot(*velocity[:2]) / (2.0 * BRAKES)
    return place[0] + velocity[0] * braking_time, place[1] + velocity[1] * braking_time, place[2]
