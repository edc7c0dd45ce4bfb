"""Commands of each autopilot for a motion, as data. Pure: a state and a goal in, an order out.

ArduPilot keeps the last position setpoint in GUIDED; its ground station failsafe ends a motion when this
computer fails. PX4 needs a stream of setpoints in OFFBOARD and acts on its end, independent of ground
stations; a moving target sets the speed. Autonomous motions of PX4 (DO_REPOSITION, an orbit, a takeoff mode)
continue while any ground station sends heartbeats, so they are used for fixed wings only, which have no known
alternative.

ArduPilot's position controller starts with the autopilot's own speed regardless of earlier commands, and then
keeps the commanded one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from msgspec import Struct

from lfield_mavlink.contact.vehicle_state import VehicleState
from lfield_mavlink.geodesy import Place, Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import PX4, Profile
from lfield_mavlink.setpoints.speed_correction import PX4_ROVER_EXCESS, SpeedCorrection
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
#: The assumed share of the speed; the time without an approach is at least so many times the time that the
#: approach needs at this speed.
_SLOWEST, _CERTAIN = 0.5, 4.0
#: Lead of the goal on an orbit, in radians.
_AHEAD = 0.5
#: Speed of PX4's rover when it drives round to a heading, in m/s, and seconds between its setpoints: with
#: fewer than two per second it would leave OFFBOARD.
_ROUND, _FED = 1.5, 0.1
#: m/s horizontally if no speed is given, for motions that are mainly vertical.
_SLOW = 1.0


class Command(Struct, frozen=True):
    """A command for Exchange.command."""

    number: int
    values: tuple[float | None, ...] = ()
    place: Place | None = None


class Order(Struct, frozen=True):
    """The start and the continuation of a motion.

    First the mode is entered and the command accepted; then the mode must be one of `modes` until the motion
    is complete. `target` returns the setpoint for the present position, sent every `period` seconds; or a
    `trajectory` is followed, even after completion. `speed` is horizontal, if known: it is in the command or
    the trajectory, or commanded separately. `goal` is the farthest position from home on the way, if known.
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
    def has_destination(self) -> bool:
        """Whether the motion has a destination and is not a landing or a return."""
        return not (self.command is None and self.target is None and self.trajectory is None)


class ProgressPatience(Struct, frozen=True):
    """The longest time without an approach of `closer` metres, and the error after it, a text with
    `{seconds}`, `{left}` and `{clearance}`.

    A moving vehicle may take `turning` seconds, or the time for `detour` metres: a car-like rover first
    drives away from a goal behind it. The vehicle may move `clearance` metres from its start.
    """

    seconds: float = 10.0
    closer: float = 0.1
    turning: float = 0.0
    detour: float = 0.0
    clearance: float = math.inf
    message: str = "no progress for {seconds:g} s, {left:.1f} m from its goal"

    def bound(self, is_moving: bool, speed: float | None) -> float:
        """The longest permitted seconds without an approach, at a speed in m/s if known.

        The actual speed may be half of it: acceleration, turns, corrections.
        """
        slowest = math.inf if speed is None else _SLOWEST * speed
        time_limit = max(self.seconds, _CERTAIN * self.closer / slowest)
        return max(time_limit, self.turning, self.detour / slowest) if is_moving else time_limit


class Circle(Struct, frozen=True):
    """An orbit: centre in metres of home, radius in m, speed in m/s, direction."""

    centre: Vector
    radius: float
    speed: float
    clockwise: bool

    @property
    def farthest(self) -> Vector:
        """The position on the circle that is farthest from home."""
        north, east, down = self.centre
        distance = math.hypot(north, east)
        share = (distance + self.radius) / distance if distance else 0.0
        return (north * share, east * share, down) if distance else (self.radius, 0.0, down)


class AutopilotOrders(Protocol):
    """The orders of one autopilot. PX4's need a state with a position and a home."""

    def take_off(self, state: VehicleState, height: float) -> Order:
        """Climbs vertically to a height above home."""

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """Moves to a position, in metres of home, at a horizontal speed; None: the autopilot's own."""

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """Turns on the spot to a heading; a vehicle that cannot drives round, within the speed."""

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """Orbits a position."""


class ArduPilot:
    """Orders for ArduPilot, all in GUIDED."""

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
        """CONDITION_YAW, in degrees. A rover does not support it; it turns by setpoints, which end after
        3 s.
        """
        if state.kind == "rover":
            target = Target(ONLY_YAW, yaw=math.remainder(heading, math.tau))
            return Order(self.guided, mode="GUIDED", target=lambda _: target)
        command = Command(dialect.MAV_CMD_CONDITION_YAW, (math.degrees(heading) % 360.0,))
        return Order(self.guided, mode="GUIDED", command=command)

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """A goal that leads on the circle: ArduPilot does not support DO_ORBIT."""

        def lead_target(place: Vector) -> Target:
            centre, turn = circle.centre, _AHEAD if circle.clockwise else -_AHEAD
            angle = math.atan2(place[1] - centre[1], place[0] - centre[0]) + turn
            north = centre[0] + circle.radius * math.cos(angle)
            east = centre[1] + circle.radius * math.sin(angle)
            return Target(ONLY_POSITION, (north, east, centre[2]))

        return Order(
            self.guided,
            mode="GUIDED",
            target=lead_target,
            period=0.2,
            speed=circle.speed,
            goal=circle.farthest,
        )


class Px4:
    """Orders for PX4's copters and rovers: setpoints in OFFBOARD."""

    guided = frozenset({"OFFBOARD"})

    def take_off(self, state: VehicleState, height: float) -> Order:
        """A climbing target from the present position."""
        north, east, _ = place = _required(state.position)
        goal = (north, east, -height)
        return Order(self.guided, trajectory=Leg(place, state.velocity, goal, _SLOW, climb=LIFTS))

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """A target on the straight line, with an unchanged heading; a rover gets a velocity towards it."""
        place, path_speed = _required(state.position), speed or _SLOW
        trajectory: Trajectory = Leg(place, state.velocity, goal, path_speed)
        if state.kind == "rover":
            trajectory = Pursuit(goal, path_speed, SpeedCorrection(excess=PX4_ROVER_EXCESS))
        return Order(self.guided, trajectory=trajectory, speed=path_speed, goal=goal)

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """A target at the present position, with the heading in radians.

        A rover ignores the heading, as recorded, so it gets a velocity in that direction.
        """
        place, yaw = _required(state.position), math.remainder(heading, math.tau)
        if state.kind == "rover":
            turn_speed = min(speed or _ROUND, _ROUND)
            turn_speed = SpeedCorrection(excess=PX4_ROVER_EXCESS).commanded(turn_speed)
            velocity = (turn_speed * math.cos(heading), turn_speed * math.sin(heading), 0.0)
            return Order(self.guided, target=lambda _: Target(ONLY_VELOCITY, velocity=velocity), period=_FED)
        return Order(self.guided, trajectory=Leg(place, state.velocity, place, speed or _SLOW, yaw=yaw))

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """A target on the circle."""
        ring = Ring(
            _required(state.position),
            state.velocity,
            circle.centre,
            circle.radius,
            circle.speed,
            clockwise=circle.clockwise,
        )
        return Order(self.guided, trajectory=ring, speed=circle.speed, goal=circle.farthest)


class Px4Plane:
    """Orders for PX4's fixed wings, autonomous motions that end in AUTO.LOITER."""

    hold = frozenset({"AUTO.LOITER"})

    def take_off(self, state: VehicleState, height: float) -> Order:
        """NAV_TAKEOFF with the height above mean sea level; without one it would be MIS_TAKEOFF_ALT."""
        modes = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"})
        altitude = _global(state, (0.0, 0.0, -height)).altitude
        return Order(modes, command=Command(dialect.MAV_CMD_NAV_TAKEOFF, (None,) * 6 + (altitude,)))

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """DO_REPOSITION with an unchanged heading."""
        return reposition(state, goal, speed)

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """DO_REPOSITION to the present position, with the heading in radians."""
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
    """DO_REPOSITION of PX4, which flies there in its hold mode and stays."""
    place, path_speed = _global(state, goal), -1.0 if speed is None else speed
    command = Command(dialect.MAV_CMD_DO_REPOSITION, (path_speed, _CHANGE_MODE, 0.0, yaw), place)
    return Order(frozenset({"AUTO.LOITER"}), command=command, goal=goal)


def _global(state: VehicleState, place: Vector | None) -> Place:
    """A position relative to home on the Earth."""
    assert state.home is not None, "the caller has checked it"
    return state.home.shifted(_required(place), state.radius)


def _required(place: Vector | None) -> Vector:
    assert place is not None, "the caller has checked it"
    return place


def orders_for(profile: Profile) -> AutopilotOrders:
    """The orders of a kind of vehicle under its autopilot."""
    if profile.autopilot == PX4:
        return Px4Plane() if profile.kind == "plane" else Px4()
    return ArduPilot()
