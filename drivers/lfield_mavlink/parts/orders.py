"""What each autopilot must be sent for a motion, as data. Pure: a state and a goal in, an order out.

ArduPilot takes setpoints in its mode GUIDED and keeps the last one of a position. PX4 takes a DO_REPOSITION
for that and does it by itself; its setpoint mode OFFBOARD is only for velocities, since it must be fed.

Their speeds differ, too. ArduPilot's control of a position begins with the autopilot's own speed, whatever
was told before, and then keeps what it is told; PX4 is told with each goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from lfield_mavlink.contact.state import VehicleState
from lfield_mavlink.geo import Place, Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4

# type_mask of SET_POSITION_TARGET_LOCAL_NED: everything ignored but what the name says.
ONLY_POSITION, ONLY_VELOCITY, VELOCITY_AND_YAW_RATE, ONLY_YAW = 0x0DF8, 0x0DC7, 0x05C7, 0x09FF
#: MAV_DO_REPOSITION_FLAGS_CHANGE_MODE.
_CHANGE_MODE = 1.0
#: m/s by which PX4's rover drives faster than it is told, as recorded (1.5 for 1.0), and the least share of a
#: speed that it is told because of that.
_EXCESS, _LEAST_SHARE = 0.45, 0.5
#: The share of a speed that is reckoned with, and how often it must have come closer by so much in a time
#: until it is known that it does not.
_SLOWEST, _CERTAIN = 0.5, 4.0
#: How far ahead on an orbit the goal is, in radians.
_AHEAD = 0.5
#: How fast PX4's rover drives round to a heading, in m/s, and the seconds between its setpoints: without two
#: in a second it would leave OFFBOARD.
_ROUND, _FED = 1.5, 0.1


@dataclass(frozen=True, slots=True)
class Target:
    """A setpoint in metres of home and m/s; `mask` says what counts."""

    mask: int
    place: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0


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
    seconds; `speed` is the one over ground that it is flown with, where that is known: it is in the command,
    or is told beside the setpoints. `goal` is the place that is farthest from home on the way, as far as it
    is known.
    """

    modes: frozenset[str]
    mode: str = ""
    command: Command | None = None
    target: Callable[[Vector], Target] | None = None
    period: float = 1.0
    speed: float | None = None
    goal: Vector | None = None


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

    def told_speed(self, state: VehicleState, speed: float) -> float:
        """What it is to be told, so that it is not faster than `speed` over ground."""


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

    def told_speed(self, state: VehicleState, speed: float) -> float:
        """Just that."""
        return speed


class Px4:
    """Orders for PX4: what it does by itself ends by itself, in AUTO.LOITER."""

    hold = frozenset({"AUTO.LOITER"})

    def take_off(self, state: VehicleState, height: float) -> Order:
        """NAV_TAKEOFF with the height above mean sea level; without one it would be MIS_TAKEOFF_ALT."""
        modes = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"})
        altitude = _global(state, (0.0, 0.0, -height)).altitude
        return Order(modes, command=Command(dialect.MAV_CMD_NAV_TAKEOFF, (None,) * 6 + (altitude,)))

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """DO_REPOSITION, with the heading left as it is."""
        return self._reposition(state, goal, None, speed)

    def turn(self, state: VehicleState, heading: float, speed: float | None) -> Order:
        """DO_REPOSITION to where it is, with the heading in radians.

        A rover takes no notice of that heading, as recorded: it is given a velocity there, which it turns to.
        """
        if state.kind == "rover":
            told = self.told_speed(state, min(speed or _ROUND, _ROUND))
            velocity = (told * math.cos(heading), told * math.sin(heading), 0.0)
            target = Target(ONLY_VELOCITY, velocity=velocity)
            return Order(frozenset({"OFFBOARD"}), target=lambda _: target, period=_FED)
        return self._reposition(state, state.position, math.remainder(heading, math.tau), speed)

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """DO_ORBIT; a negative radius is counter-clockwise."""
        radius = circle.radius if circle.clockwise else -circle.radius
        place = _global(state, circle.centre)
        command = Command(dialect.MAV_CMD_DO_ORBIT, (radius, circle.speed, None, None), place)
        modes = frozenset({"POSCTL.ORBIT"})
        return Order(modes, command=command, speed=circle.speed, goal=circle.farthest)

    def told_speed(self, state: VehicleState, speed: float) -> float:
        """Less for a rover, which drives faster than it is told."""
        return max(speed - _EXCESS, speed * _LEAST_SHARE) if state.kind == "rover" else speed

    def _reposition(
        self, state: VehicleState, goal: Vector | None, yaw: float | None, speed: float | None
    ) -> Order:
        place, told = _global(state, goal), -1.0 if speed is None else self.told_speed(state, speed)
        command = Command(dialect.MAV_CMD_DO_REPOSITION, (told, _CHANGE_MODE, 0.0, yaw), place)
        return Order(self.hold, command=command, goal=goal)


def _global(state: VehicleState, place: Vector | None) -> Place:
    """A place near home on the Earth."""
    assert state.home is not None, "the caller has looked"
    assert place is not None, "the caller has looked"
    return state.home.shifted(place, state.radius)


ORDERS: Mapping[int, Stack] = {ARDUPILOT: ArduPilot(), PX4: Px4()}
