"""How fast a place is flown to, and which order of commands an autopilot keeps a speed in.

An autopilot has a speed of its own (a parameter), a speed that a goal came with, and one that
DO_CHANGE_SPEED set. Which of them counts, and what makes it forget, is a rule of each (measured: the traces
`c-speed` of ArduCopter 4.7, ArduRover 4.7 and PX4 1.17). Speeds in m/s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from lfield_sim.autopilot.flavours import Control, Result

Own = Callable[[], float]


@dataclass(slots=True)
class CopterPace:
    """ArduCopter: whatever starts position control starts it at WPNAV_SPEED; what was set before is lost.

    A mode, a takeoff or a velocity setpoint ends it, so the next place starts it again. DO_CHANGE_SPEED is
    accepted at any time; the speed of DO_REPOSITION is accepted and ignored.
    """

    own: Own
    cap: Own = lambda: math.inf
    _speed: float | None = None
    _control: Control | None = None

    @property
    def speed(self) -> float:
        """What is flown to a place now."""
        return self.own() if self._speed is None else self._speed

    def enter(self, *, guided: bool) -> None:
        """A mode was entered, or a takeoff began."""
        self._control, self._speed = None, self.own()

    def arm(self) -> None:
        """It was armed; what was set before is lost by the next goal anyway."""

    def begin(self, control: Control, asked: float | None = None) -> bool:
        """A goal came; False when it is refused for the speed that it came with."""
        if control is not self._control or control is Control.BOTH:
            self._speed = self.own()
        self._control = control
        return True

    def change(self, speed: float) -> Result:
        """DO_CHANGE_SPEED."""
        if speed <= 0.0:
            return Result.DENIED
        self._speed = speed
        return Result.ACCEPTED


@dataclass(slots=True)
class RoverPace:
    """ArduRover: a speed is taken only on the way to a place, and kept until the mode is entered anew.

    WP_SPEED acts at once. Before the first place of a GUIDED, DO_CHANGE_SPEED fails, and so does a
    DO_REPOSITION that brings a speed.
    """

    own: Own
    cap: Own = lambda: math.inf
    _set: tuple[float, float] | None = None
    _control: Control | None = None
    _guided: bool = False

    @property
    def is_commanded(self) -> bool:
        """Whether DO_CHANGE_SPEED has set it: then the rover shoots over it (ap-rover.c-speed)."""
        return self._set is not None

    @property
    def speed(self) -> float:
        """What is driven to a place now; a parameter that has changed since goes before what was set."""
        own = self.own()
        return self._set[0] if self._set is not None and self._set[1] == own else own

    def enter(self, *, guided: bool) -> None:
        """A mode was entered."""
        self._control, self._set, self._guided = None, None, guided

    def arm(self) -> None:
        """It was armed; what was set before is lost by the next goal anyway."""

    def begin(self, control: Control, asked: float | None = None) -> bool:
        """A goal came; False when it is refused for the speed that it came with."""
        if asked is not None and self.change(asked) is not Result.ACCEPTED:
            return False
        self._control = control
        return True

    def change(self, speed: float) -> Result:
        """DO_CHANGE_SPEED."""
        if speed <= 0.0:
            return Result.DENIED
        if self._guided and self._control is not Control.PLACE:
            return Result.FAILED
        self._set = (speed, self.own())
        return Result.ACCEPTED


@dataclass(slots=True)
class Px4Pace:
    """PX4: the speed of a goal is for this goal, DO_CHANGE_SPEED holds until it is told -1, or is armed anew.

    It says yes to any number. Over all of them is MPC_XY_VEL_MAX; a place by setpoint is flown to at that.
    """

    own: Own
    cap: Own = lambda: math.inf
    _kept: float | None = None
    _asked: float | None = None
    _guided: bool = False

    @property
    def speed(self) -> float:
        """What is flown to a place now."""
        return self.cap() if self._guided else min(self._asked or self._kept or self.own(), self.cap())

    def enter(self, *, guided: bool) -> None:
        """A mode was entered."""
        self._asked, self._guided = None, guided

    def arm(self) -> None:
        """It was armed."""
        self._kept = None

    def begin(self, control: Control, asked: float | None = None) -> bool:
        """A goal came, with a speed of its own or without."""
        self._asked = asked
        return True

    def change(self, speed: float) -> Result:
        """DO_CHANGE_SPEED."""
        self._kept, self._asked = (speed if speed > 0.0 else None), None
        return Result.ACCEPTED
