"""Moving targets for setpoints, with bounded speed. Pure.

PX4 does not shape a step of a position setpoint in OFFBOARD: it flies there as fast as MPC_XY_VEL_MAX allows.
So the target itself moves within the permitted speed, and waits when the vehicle falls behind.

PX4's position controller is proportional (MPC_XY_P 0.95, MPC_Z_P 1.0 per second;
https://docs.px4.io/main/en/flight_stack/controller_diagrams): the vehicle follows the target at a distance of
about one second of its speed, and in steady motion has exactly the target's speed in any wind.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

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


@dataclass(frozen=True, slots=True)
class Target:
    """A setpoint in metres of home and m/s; `mask` selects the fields."""

    mask: int
    place: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0

    def message(self, system: int, home: Vector) -> Any:
        """SET_POSITION_TARGET_LOCAL_NED for a system; `home` is in its local frame, in metres."""
        place = (mine + h for mine, h in zip(self.place, home, strict=True))
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

    def __init__(self, start: Vector, speed: float, pace: float = 0.0) -> None:
        self.speed = speed
        self._point, self._pace = start, pace
        self._at: float | None = None

    def target(self, now: float, place: Vector | None, velocity: Vector) -> Target:
        """The setpoint, as in Trajectory."""
        since = 0.0 if self._at is None else min(max(0.0, now - self._at), LONGEST)
        self._at = now
        if place is not None:
            self._move(since, self._share(place))
        return self._setpoint()

    def _setpoint(self) -> Target:
        return Target(ONLY_POSITION, self._point)

    def _share(self, place: Vector) -> float:
        """The share of its speed at which the target may move: 0 at maximum lead."""
        level = math.dist(self._point[:2], place[:2]) / (LEAD_TIME * self.speed + LEAD)
        upright = abs(self._point[2] - place[2]) / (LEAD_TIME * CLIMB + LEAD)
        return min(1.0, max(0.0, (1.0 - max(level, upright)) / SLOWS))

    def _move(self, since: float, share: float) -> None:
        raise NotImplementedError

    def _step_to(self, goal: Vector, since: float, share: float, climb: float) -> None:
        """Moves straight to a goal and stops there."""
        way = tuple(g - p for g, p in zip(goal, self._point, strict=True))
        left = math.hypot(*way)
        if left < 1e-6:
            self._pace = 0.0
            return
        level, down = math.hypot(*way[:2]) / left, way[2] / left
        fastest = min(
            self.speed / level if level > 1e-6 else math.inf,
            (SINK if down > 0.0 else climb) / abs(down) if abs(down) > 1e-6 else math.inf,
        )
        braking = max(LEAST, math.sqrt(2.0 * LOSES * left))
        self._pace = min(fastest, self._pace + GAINS * since, braking)
        step = min(1.0, self._pace * share * since / left)
        north, east, below = (p + w * step for p, w in zip(self._point, way, strict=True))
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
        start, pace = _underway(place, velocity, goal)
        super().__init__(start, speed, pace)
        self._goal, self._climb, self._yaw = goal, climb, yaw

    def _move(self, since: float, share: float) -> None:
        self._step_to(self._goal, since, share, self._climb)

    def _setpoint(self) -> Target:
        if self._yaw is None:
            return Target(ONLY_POSITION, self._point)
        return Target(POSITION_AND_YAW, self._point, yaw=self._yaw)


class Stay(_Moving):
    """Stays at a position: a stop, or a hover."""

    def __init__(self, place: Vector, speed: float) -> None:
        super().__init__(place, speed)

    def _move(self, since: float, share: float) -> None:
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
        self._on = False
        self.speed = speed
        start, pace = _underway(place, velocity, self._entry)
        super().__init__(start, speed, pace)

    @property
    def _entry(self) -> Vector:
        """The point where the target is on, or enters, its circle."""
        lag = (self.speed * FOLLOWS) ** 2
        square = self._radius**2
        wide = math.sqrt((square + math.sqrt(square**2 + 4.0 * square * lag)) / 2.0)
        north = self._centre[0] + wide * math.cos(self._angle)
        east = self._centre[1] + wide * math.sin(self._angle)
        return (north, east, self._centre[2])

    def _move(self, since: float, share: float) -> None:
        entry = self._entry
        if not self._on:
            self._step_to(entry, since, share, CLIMB)
            self._on = math.dist(self._point, entry) <= ON_CIRCLE
            return
        self._pace = min(self.speed, self._pace + GAINS * since)
        wide = math.dist(entry[:2], self._centre[:2])
        turned = self._pace * share * since / wide
        self._angle += turned if self._clockwise else -turned
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
        left = math.hypot(north, east)
        if left < 1e-6:
            return Target(ONLY_VELOCITY)
        braking = math.sqrt(2.0 * ROVER_BRAKES * left)
        if braking > self.speed:
            self._correction.follow(velocity, (north, east), self.speed, now)
        else:
            self._correction.pause()
        fast = self._correction.commanded(min(self.speed, braking))
        return Target(ONLY_VELOCITY, velocity=(fast * north / left, fast * east / left, 0.0))


def _underway(place: Vector, velocity: Vector, goal: Vector) -> tuple[Vector, float]:
    """Start of a target for a moving vehicle, and its speed towards the goal.

    The target continues the vehicle's own speed, not beyond the goal.
    """
    way = tuple(g - p for g, p in zip(goal, place, strict=True))
    left = math.hypot(*way)
    if left < 1e-6:
        return place, 0.0
    along = max(0.0, sum(w * v for w, v in zip(way, velocity, strict=True)) / left)
    share = min(1.0, along * FOLLOWS / left)
    north, east, down = (p + w * share for p, w in zip(place, way, strict=True))
    return (north, east, down), along


def stopping_place(place: Vector, velocity: Vector) -> Vector:
    """The place where a vehicle would come to rest by braking now, in metres of home.

    To a position behind that place, a car-like rover would drive a loop.
    """
    way = math.hypot(*velocity[:2]) / (2.0 * BRAKES)
    return place[0] + velocity[0] * way, place[1] + velocity[1] * way, place[2]
