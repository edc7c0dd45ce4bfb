"""A gimbal with pitch and yaw, and its controllers. Angles in radians: pitch up, yaw clockwise from the nose.

Control is that of the gimbal protocol, https://mavlink.io/en/services/gimbal_v2.html.
"""

from __future__ import annotations

import math

from msgspec import Struct

from lfield_sim.autopilot.body.goals import Vector
from lfield_sim.autopilot.flavours import MavResult

#: Greatest rate in rad/s; range of the angles.
GIMBAL_RATE = math.radians(90.0)
PITCH_RANGE = (math.radians(-90.0), math.radians(30.0))
YAW_RANGE = (math.radians(-170.0), math.radians(170.0))
#: A station: system and component.
Sender = tuple[int, int]
NO_SENDER: Sender = (0, 0)
#: Values of DO_GIMBAL_MANAGER_CONFIGURE: no change, the sender, no station.
UNCHANGED, MYSELF, RELEASED = -1, -2, -3


class GimbalModel(Struct):
    """A gimbal: follows angles, rates, or a place (`target`, in the local frame).

    With `is_locked` the goal of its yaw is from north, not from the nose.
    """

    pitch: float = 0.0
    yaw: float = 0.0
    pitch_goal: float = 0.0
    yaw_goal: float = 0.0
    is_locked: bool = False
    rates: tuple[float, float] = (0.0, 0.0)
    target: Vector | None = None
    primary: Sender = NO_SENDER
    secondary: Sender = NO_SENDER
    #: Whether the gimbal does not report its controllers.
    is_secret: bool = False

    def point(self, pitch: float | None, yaw: float | None, *, locked: bool = False) -> None:
        """Turns to angles; None keeps one."""
        self.target, self.rates, self.is_locked = None, (0.0, 0.0), locked
        self.pitch_goal = self.pitch_goal if pitch is None else pitch
        self.yaw_goal = self.yaw_goal if yaw is None else yaw

    def turn(self, pitch_rate: float, yaw_rate: float) -> None:
        """Turns at rates in rad/s until its next goal or the end of its range."""
        self.target, self.is_locked = None, False
        self.pitch_goal, self.yaw_goal = self.pitch, self.yaw
        self.rates = (pitch_rate, yaw_rate)

    def watch(self, target: Vector | None) -> None:
        """Follows a place in the local frame; None: back to the neutral position."""
        self.point(0.0, 0.0)
        self.target = target

    def configure(self, source: Sender, primary: Sender, secondary: Sender) -> MavResult:
        """Changes the controllers; the values are ids, or UNCHANGED, MYSELF or RELEASED."""
        if not all(RELEASED <= part <= 255 for part in (*primary, *secondary)):
            return MavResult.FAILED
        self.primary = _holder(self.primary, source, primary)
        self.secondary = _holder(self.secondary, source, secondary)
        return MavResult.ACCEPTED

    def step(self, dt: float, place: Vector, heading: float) -> None:
        """Advances time by `dt` seconds, on a vehicle at a place with a heading."""
        pitch_rate, yaw_rate = self.rates
        self.pitch_goal += pitch_rate * dt
        self.yaw_goal += yaw_rate * dt
        pitch, yaw = self.pitch_goal, self.yaw_goal
        if self.target is not None:
            north, east, down = (goal - own for goal, own in zip(self.target, place, strict=True))
            pitch, yaw = math.atan2(-down, math.hypot(north, east)), math.atan2(east, north)
        if self.is_locked or self.target is not None:
            yaw = math.remainder(yaw - heading, math.tau)
        self.pitch = towards(self.pitch, _within(pitch, PITCH_RANGE), GIMBAL_RATE * dt)
        self.yaw = towards(self.yaw, _within(yaw, YAW_RANGE), GIMBAL_RATE * dt)


def towards(value: float, goal: float, change: float) -> float:
    """A value moved to its goal, by at most `change`."""
    return value + max(-change, min(change, goal - value))


def _within(value: float, limits: tuple[float, float]) -> float:
    return min(max(value, limits[0]), limits[1])


def _holder(holder: Sender, source: Sender, requested: Sender) -> Sender:
    system = requested[0]
    if system == UNCHANGED:
        return holder
    if system == MYSELF:
        return source
    if system == RELEASED:
        return NO_SENDER if holder == source else holder
    return requested
