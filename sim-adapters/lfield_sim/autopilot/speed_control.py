"""The speed to a position under each autopilot, depending on the order of commands.

An autopilot has its own speed (a parameter), one that came with a goal, and one set by DO_CHANGE_SPEED. The
speed that applies, and the time when it is forgotten, differ (measured: the traces `c-speed` of ArduCopter
4.7, ArduRover 4.7 and PX4 1.17). Speeds in m/s.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from msgspec import Struct

from lfield_sim.autopilot.flavours import MavResult, SetpointControl

OwnSpeed = Callable[[], float]


class CopterSpeedControl(Struct):
    """ArduCopter: starting the position controller resets the speed to WPNAV_SPEED.

    A mode, a takeoff or a velocity setpoint ends it, so the next position starts it again. DO_CHANGE_SPEED is
    accepted at any time; the speed of DO_REPOSITION is accepted and ignored.
    """

    own_speed: OwnSpeed
    cap: OwnSpeed = lambda: math.inf
    _speed: float | None = None
    _control: SetpointControl | None = None

    @property
    def speed(self) -> float:
        """The present speed to a position."""
        return self.own_speed() if self._speed is None else self._speed

    def enter(self, *, guided: bool) -> None:
        """Ends the position controller: a mode was entered, or a takeoff started."""
        self._control, self._speed = None, self.own_speed()

    def arm(self) -> None:
        """Has no effect: the next goal discards an earlier speed anyway."""

    def start(self, control: SetpointControl, requested: float | None = None) -> bool:
        """Handles a goal; False when it is refused for its speed."""
        if control is not self._control or control is SetpointControl.BOTH:
            self._speed = self.own_speed()
        self._control = control
        return True

    def change(self, speed: float) -> MavResult:
        """Handles DO_CHANGE_SPEED."""
        if speed <= 0.0:
            return MavResult.DENIED
        self._speed = speed
        return MavResult.ACCEPTED


class RoverSpeedControl(Struct):
    """ArduRover: accepts a speed only on the way to a position, and keeps it until the mode is entered again.

    WP_SPEED acts at once. Before the first position in GUIDED, DO_CHANGE_SPEED fails, and so does a
    DO_REPOSITION with a speed.
    """

    own_speed: OwnSpeed
    cap: OwnSpeed = lambda: math.inf
    _set: tuple[float, float] | None = None
    _control: SetpointControl | None = None
    _guided: bool = False

    @property
    def is_commanded(self) -> bool:
        """Whether DO_CHANGE_SPEED has set the speed: then the rover overshoots it (ap-rover.c-speed)."""
        return self._set is not None

    @property
    def speed(self) -> float:
        """The present speed to a position; a parameter that changed later has priority."""
        own_speed = self.own_speed()
        return self._set[0] if self._set is not None and self._set[1] == own_speed else own_speed

    def enter(self, *, guided: bool) -> None:
        """Discards the speed: a mode was entered."""
        self._control, self._set, self._guided = None, None, guided

    def arm(self) -> None:
        """Has no effect: the next goal discards an earlier speed anyway."""

    def start(self, control: SetpointControl, requested: float | None = None) -> bool:
        """Handles a goal; False when it is refused for its speed."""
        if requested is not None and self.change(requested) is not MavResult.ACCEPTED:
            return False
        self._control = control
        return True

    def change(self, speed: float) -> MavResult:
        """Handles DO_CHANGE_SPEED."""
        if speed <= 0.0:
            return MavResult.DENIED
        if self._guided and self._control is not SetpointControl.PLACE:
            return MavResult.FAILED
        self._set = (speed, self.own_speed())
        return MavResult.ACCEPTED


class Px4SpeedControl(Struct):
    """PX4: a goal's speed applies to this goal, DO_CHANGE_SPEED until -1, or arming.

    It accepts any number. MPC_XY_VEL_MAX caps all; position setpoints use that.
    """

    own_speed: OwnSpeed
    cap: OwnSpeed = lambda: math.inf
    _changed_speed: float | None = None
    _goal_speed: float | None = None
    _guided: bool = False

    @property
    def speed(self) -> float:
        """The present speed to a position."""
        if self._guided:
            return self.cap()
        return min(self._goal_speed or self._changed_speed or self.own_speed(), self.cap())

    def enter(self, *, guided: bool) -> None:
        """A mode was entered."""
        self._goal_speed, self._guided = None, guided

    def arm(self) -> None:
        """Discards the speed of DO_CHANGE_SPEED when the vehicle is armed."""
        self._changed_speed = None

    def start(self, control: SetpointControl, requested: float | None = None) -> bool:
        """Handles a goal, with or without its own speed."""
        self._goal_speed = requested
        return True

    def change(self, speed: float) -> MavResult:
        """Handles DO_CHANGE_SPEED."""
        self._changed_speed, self._goal_speed = (speed if speed > 0.0 else None), None
        return MavResult.ACCEPTED
