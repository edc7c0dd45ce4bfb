"""What each autopilot must be sent for a motion, as data. Pure: a state and a goal in, an order out.

ArduPilot takes setpoints in its mode GUIDED and keeps the last one of a position. PX4 takes a DO_REPOSITION
for that and does it by itself; its setpoint mode OFFBOARD is only for velocities, since it must be fed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from lfield_mavlink.contact.state import VehicleState
from lfield_mavlink.geo import Place, Vector
from lfield_mavlink.link.dialect import dialect
from lfield_mavlink.modes import ARDUPILOT, PX4

# type_mask of SET_POSITION_TARGET_LOCAL_NED: everything ignored but what the name says.
ONLY_POSITION, ONLY_VELOCITY, VELOCITY_AND_YAW_RATE = 0x0DF8, 0x0DC7, 0x05C7
#: MAV_DO_REPOSITION_FLAGS_CHANGE_MODE.
_CHANGE_MODE = 1.0
#: How far ahead on an orbit the goal is, in radians.
_AHEAD = 0.5


@dataclass(frozen=True, slots=True)
class Target:
    """A setpoint in metres of home and m/s; `mask` says what counts."""

    mask: int
    place: Vector = (0.0, 0.0, 0.0)
    velocity: Vector = (0.0, 0.0, 0.0)
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

    First the parameters are set, the mode is entered, and the command is accepted; then the mode must be
    one of `modes`, and stays so until the motion is over. `target` gives the setpoint for the present
    position, to be sent every `period` seconds.
    """

    modes: frozenset[str]
    parameters: Mapping[str, float] = field(default_factory=dict)
    mode: str = ""
    command: Command | None = None
    target: Callable[[Vector], Target] | None = None
    period: float = 1.0


@dataclass(frozen=True, slots=True)
class Circle:
    """An orbit: centre in metres of home, radius in m, speed in m/s, clockwise or not."""

    centre: Vector
    radius: float
    speed: float
    clockwise: bool


class Stack(Protocol):
    """The orders of one autopilot. PX4's need a state with a position and a home."""

    def take_off(self, height: float) -> Order:
        """Straight up to a height above home."""

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """To a place, in metres of home, at a speed over ground; None leaves it to the autopilot."""

    def turn(self, state: VehicleState, heading: float) -> Order:
        """On the spot, to a heading."""

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """Around a place."""


class ArduPilot:
    """Orders for ArduPilot: all in the mode GUIDED."""

    guided = frozenset({"GUIDED"})

    def take_off(self, height: float) -> Order:
        """NAV_TAKEOFF with the height above home."""
        command = Command(dialect.MAV_CMD_NAV_TAKEOFF, (None,) * 6 + (height,))
        return Order(self.guided, mode="GUIDED", command=command)

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """The goal as a setpoint, repeated since a packet may be lost; the speed by DO_CHANGE_SPEED."""
        command = None if speed is None else _at_speed(speed)
        return Order(
            self.guided, mode="GUIDED", command=command, target=lambda _: Target(ONLY_POSITION, goal)
        )

    def turn(self, state: VehicleState, heading: float) -> Order:
        """CONDITION_YAW, in degrees."""
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

        command = _at_speed(circle.speed)
        return Order(self.guided, mode="GUIDED", command=command, target=ahead, period=0.2)


class Px4:
    """Orders for PX4: what it does by itself ends by itself, in AUTO.LOITER."""

    hold = frozenset({"AUTO.LOITER"})

    def take_off(self, height: float) -> Order:
        """NAV_TAKEOFF; the height is a parameter."""
        modes = frozenset({"AUTO.TAKEOFF", "AUTO.LOITER"})
        command = Command(dialect.MAV_CMD_NAV_TAKEOFF)
        return Order(modes, parameters={"MIS_TAKEOFF_ALT": height}, command=command)

    def go_to(self, state: VehicleState, goal: Vector, speed: float | None) -> Order:
        """DO_REPOSITION, with the heading left as it is."""
        return self._reposition(state, goal, None, speed)

    def turn(self, state: VehicleState, heading: float) -> Order:
        """DO_REPOSITION to where it is, with the heading in radians."""
        return self._reposition(state, state.position, math.remainder(heading, math.tau))

    def orbit(self, state: VehicleState, circle: Circle) -> Order:
        """DO_ORBIT; a negative radius is counter-clockwise."""
        radius = circle.radius if circle.clockwise else -circle.radius
        place = _global(state, circle.centre)
        command = Command(dialect.MAV_CMD_DO_ORBIT, (radius, circle.speed, None, None), place)
        return Order(frozenset({"POSCTL.ORBIT"}), command=command)

    def _reposition(
        self, state: VehicleState, goal: Vector | None, yaw: float | None, speed: float | None = None
    ) -> Order:
        place, speed = _global(state, goal), -1.0 if speed is None else speed
        command = Command(dialect.MAV_CMD_DO_REPOSITION, (speed, _CHANGE_MODE, 0.0, yaw), place)
        return Order(self.hold, command=command)


def _at_speed(speed: float) -> Command:
    """The speed over ground, which ArduPilot forgets with every change of mode."""
    return Command(dialect.MAV_CMD_DO_CHANGE_SPEED, (1.0, speed, -1.0))


def _global(state: VehicleState, place: Vector | None) -> Place:
    """A place near home on the Earth."""
    assert state.home is not None, "the caller has looked"
    assert place is not None, "the caller has looked"
    return state.home.shifted(place)


ORDERS: Mapping[int, Stack] = {ARDUPILOT: ArduPilot(), PX4: Px4()}
