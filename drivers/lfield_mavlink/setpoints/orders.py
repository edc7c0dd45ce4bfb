"""What each autopilot must be sent for a motion, as data. Pure: a state and a goal in, an order out.

ArduPilot takes setpoints in its mode GUIDED and keeps the last one of a position: its failsafe for the ground
station ends a motion when this computer is gone. PX4 moves by a stream of setpoints in OFFBOARD, whose end it
acts on whatever ground stations there are; a target that moves sets the speed. What it would fly by itself (a
DO_REPOSITION, an orbit, a takeoff by its own modes) goes on as long as any ground station is heard, so only
a fixed wing, for which nothing else is known to work, is commanded so.

ArduPilot's control of a position begins with the autopilot's own speed, whatever was commanded before, and
then keeps what it is commanded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from lfield_mavlink.contact.state import VehicleState
from lfield_mavlink.geo import Place, Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import PX4, Profile
from lfield_mavlink.setpoints.correction import PX4_ROVER_EXCESS, SpeedCorrection
from lfield_mavlink.setpoints.trajectory import (
    LIFTS,
    ONLY_POSITION,
    ONLY_VELOCITY,
    ONLY_YAW,
    Leg,
    Pursuit,
    Ring,
    Target,
    Trajectory,
)

#: MAV_DO_REPOSITION_FLAGS_CHANGE_MODE.
_CHANGE_MODE = 1.0
#: The share of a speed that is reckoned with, and how often it must have come closer by so much in a time
#: until it is known that it does not.
_SLOWEST, _CERTAIN = 0.5, 4.0
#: How far ahead on an orbit the goal is, in radians.
_AHEAD = 0.5
#: How fast PX4's rover drives round to a heading, in m/s, and the seconds between its setpoints: without two
#: in a second it would leave OFFBOARD.
_ROUND, _FED = 1.5, 0.1
#: m/s over ground where nothing else says a speed, for what hardly moves over ground.
_SLOW = 1.0


@dataclass(frozen=True, slots=True)
class Command:
    """A command as Exchange.command takes it."""

    number: int
    values: tuple[float | None, ...] = ()
    place: Place | None = None


@dataclass(frozen=True, slots=True)
class Order:
    """How a motion is begun and kept up.

    First the mode is entered and the command is accepted; then the mode must be one of `modes`, and stays so
    until the motion is over. `target` gives the setpoint for the present position, to be sent every `period`
    seconds; or a `trajectory` is followed, also after the motion is over. `speed` is that over ground, where
    it is known: it is in the command or the trajectory, or is commanded beside the setpoints. `goal` is the
    place that is farthest from home on the way, as far as it is known.
    """

    modes: frozenset[str]
    mode: str = ""
    command: Command | None = None
    target: Callable[[Vector], Target] | None = None
    trajectory: Trajectory | None = None
    period: float = 1.0
    speed: float | None = None
    goal: Vector | None = None

    @property
    def leads(self) -> bool:
        """Whether it leads somewhere, and is not a landing or a return."""
        return not (self.command is None and self.target is None and self.trajectory is None)


@dataclass(frozen=True, slots=True)
class Patience:
    """How long a motion may come no `closer`, and what is then said: `{seconds}`, `{left}` and `{room}`.

    While it moves it may take `turning` seconds, or as long as `detour` metres take: what steers like a car
    drives away from a goal behind it. It may come `room` metres away from where it began.
    """

    seconds: float = 10.0
    closer: float = 0.1
    turning: float = 0.0
    detour: float = 0.0
    room: float = math.inf
    words: str = "no progress for {seconds:g} s, {left:.1f} m from its goal"

    def bound(self, moves: bool, pace: float | None) -> float:
        """The seconds without coming closer that are too many, at a speed in m/s where that is known.

        What is told a speed may be half as fast: it gains speed, turns, or was corrected.
        """
        slow = math.inf if pace is None else _SLOWEST * pace
        still = max(self.seconds, _CERTAIN * self.closer / slow)
        return max(still, self.turning, self.detour / slow) if moves else still


@dataclass(frozen=True, slots=True)
class Circle:
    """An orbit: centre in metres of home, radius in m, speed in m/s, clockwise or not."""

    centre: Vector
    radius: float
    speed: float
    clockwise: bool

    @property
    def farthest(self) -> Vector:
        """The place on it that is farthest from home."""
        north, east, down = self.centre
        far = math.hypot(north, east)
        share = (far + self.radius) / far if far else 0.0
        return (north * share, east * share, down) if far else (self.radius, 0.0, down)


class Stack(Protocol):
    """The orders of one autopilot. PX4's need a state with a position and a home."""

    def take_off(self, state: VehicleState, height: float) -> Order:
        """Straight up to a height above home."""

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """To a place, in metres of home, at a speed over ground; None leaves it to the autopilot."""

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """On the spot, to a heading; what cannot do that drives round, no faster than the speed."""

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """Around a place."""


class ArduPilot:
    """Orders for ArduPilot: all in the mode GUIDED."""

    guided = frozenset({"GUIDED"})

    def take_off(self, state: VehicleState, height: float) -> Order:
        """NAV_TAKEOFF with the height above home."""
        command = Command(dialect.MAV_CMD_NAV_TAKEOFF, (None,) * 6 + (height,))
        return Order(self.guided, mode="GUIDED", command=command)

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """The goal as a setpoint, repeated since a packet may be lost."""
        target = Target(ONLY_POSITION, goal)
        return Order(self.guided, mode="GUIDED", target=lambda _: target, speed=speed, goal=goal)

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """CONDITION_YAW, in degrees. A rover does not know it; it turns by setpoints, which end after 3 s."""
        if state.kind == "rover":
            target = Target(ONLY_YAW, yaw=math.remainder(heading, math.tau))
            return Order(self.guided, mode="GUIDED", target=lambda _: target)
        command = Command(dialect.MAV_CMD_CONDITION_YAW, (math.degrees(heading) % 360.0,))
        return Order(self.guided, mode="GUIDED", command=command)

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """A goal that runs ahead on the circle: ArduPilot knows no DO_ORBIT."""

        def ahead(place: Vector) -> Target:
            centre, turn = circle.centre, _AHEAD if circle.clockwise else -_AHEAD
            angle = math.atan2(place[1] - centre[1], place[0] - centre[0]) + turn
            north = centre[0] + circle.radius * math.cos(angle)
            east = centre[1] + circle.radius * math.sin(angle)
            return Target(ONLY_POSITION, (north, east, centre[2]))

        return Order(
            self.guided, mode="GUIDED", target=ahead, period=0.2, speed=circle.speed, goal=circle.farthest
        )


class Px4:
    """Orders for PX4's copters and rovers: setpoints in OFFBOARD."""

    guided = frozenset({"OFFBOARD"})

    def take_off(self, state: VehicleState, height: float) -> Order:
        """A target that climbs from where it stands."""
        north, east, _ = place = _known(state.position)
        goal = (north, east, -height)
        return Order(self.guided, trajectory=Leg(place, state.velocity, goal, _SLOW, climb=LIFTS))

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """A target on the straight way, with the heading as it is; a rover gets a velocity towards it."""
        place, fast = _known(state.position), speed or _SLOW
        trajectory: Trajectory = Leg(place, state.velocity, goal, fast)
        if state.kind == "rover":
            trajectory = Pursuit(goal, fast, SpeedCorrection(excess=PX4_ROVER_EXCESS))
        return Order(self.guided, trajectory=trajectory, speed=fast, goal=goal)

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """Where it is, with the heading in radians.

        A rover takes no notice of that heading, as recorded: it is given a velocity there, which it turns to.
        """
        place, yaw = _known(state.position), math.remainder(heading, math.tau)
        if state.kind == "rover":
            fast = min(speed or _ROUND, _ROUND)
            fast = SpeedCorrection(excess=PX4_ROVER_EXCESS).commanded(fast)
            velocity = (fast * math.cos(heading), fast * math.sin(heading), 0.0)
            return Order(self.guided, target=lambda _: Target(ONLY_VELOCITY, velocity=velocity), period=_FED)
        return Order(self.guided, trajectory=Leg(place, state.velocity, place, speed or _SLOW, yaw=yaw))

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """A target that runs round."""
        ring = Ring(
            _known(state.position),
            state.velocity,
            circle.centre,
            circle.radius,
            circle.speed,
            clockwise=circle.clockwise,
        )
        return Order(self.guided, trajectory=ring, speed=circle.speed, goal=circle.farthest)


class Px4Plane:
    """Orders for PX4's fixed wings, which it flies by itself and ends by itself, in AUTO.LOITER."""

    hold = frozenset({"AUTO.LOITER"})

    def take_off(self, state: VehicleState, height: float) -> Order:
        """NAV_TAKEOFF with the height above mean sea level; without one it would be MIS_TAKEOFF_ALT."""
        modes = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"})
        altitude = _global(state, (0.0, 0.0, -height)).altitude
        return Order(modes, command=Command(dialect.MAV_CMD_NAV_TAKEOFF, (None,) * 6 + (altitude,)))

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """DO_REPOSITION, with the heading left as it is."""
        return reposition(state, goal, speed)

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """DO_REPOSITION to where it is, with the heading in radians."""
        return reposition(state, state.position, speed, math.remainder(heading, math.tau))

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """DO_ORBIT; a negative radius is counter-clockwise."""
        radius = circle.radius if circle.clockwise else -circle.radius
        place = _global(state, circle.centre)
        command = Command(dialect.MAV_CMD_DO_ORBIT, (radius, circle.speed, None, None), place)
        modes = frozenset({"POSCTL.ORBIT"})
        return Order(modes, command=command, speed=circle.speed, goal=circle.farthest)


def reposition(
    state: VehicleState, goal: Vector | None, speed: float | None, yaw: float | None = None
) -> Order:
    """DO_REPOSITION of PX4, which flies there by itself in its mode for staying, and stays."""
    place, fast = _global(state, goal), -1.0 if speed is None else speed
    command = Command(dialect.MAV_CMD_DO_REPOSITION, (fast, _CHANGE_MODE, 0.0, yaw), place)
    return Order(frozenset({"AUTO.LOITER"}), command=command, goal=goal)


def _global(state: VehicleState, place: Vector | None) -> Place:
    """A place near home on the Earth."""
    assert state.home is not None, "the caller has looked"
    return state.home.shifted(_known(place), state.radius)


def _known(place: Vector | None) -> Vector:
    assert place is not None, "the caller has looked"
    return place


def orders_for(profile: Profile) -> Stack:
    """The orders of a kind of vehicle under its autopilot."""
    if profile.autopilot == PX4:
        return Px4Plane() if profile.kind == "plane" else Px4()
    return ArduPilot()
