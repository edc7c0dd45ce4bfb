"""Goals of a vehicle's motion, as data."""

from __future__ import annotations

from msgspec import Struct

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


class Rest(Struct, frozen=True):
    """Goal: stay here; the rest of the speed decays as `Limits.eases` says, with 0 it brakes."""

    eases: float = 0.0


class Reach(Struct, frozen=True):
    """Goal: move to a position and stay there."""

    place: Vector


class Track(Struct, frozen=True):
    """Goal: follow a position setpoint by proportional control without shaping (PX4).

    `velocity` is added to the proportional part.
    """

    place: Vector
    velocity: Vector = ZERO


class Keep(Struct, frozen=True):
    """Goal: keep a velocity."""

    velocity: Vector


class Orbit(Struct, frozen=True):
    """Goal: orbit a position at a distance in m with a speed in m/s, clockwise when positive."""

    centre: Vector
    radius: float
    speed: float


class Lean(Struct, frozen=True):
    """Goal: keep an acceleration north and east in m/s2, and a speed downwards."""

    north: float
    east: float
    down: float


class Descend(Struct, frozen=True):
    """Goal: straight down to the ground."""


class Rise(Struct, frozen=True):
    """Goal: straight up to a height, no faster than a speed in m/s."""

    down: float
    speed: float


class Sink(Struct, frozen=True):
    """Goal: descend as with the throttle down, to a hard landing."""


class Fall(Struct, frozen=True):
    """Goal of a copter without motors."""


class Roll(Struct, frozen=True):
    """Goal of a rover without drive: it rolls out."""


Goal = Rest | Reach | Track | Keep | Orbit | Lean | Rise | Descend | Sink | Fall | Roll
