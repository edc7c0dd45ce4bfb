"""Goals of a vehicle's motion, as data."""

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Rest:
    """Goal: stay here; the rest of the speed decays as `Limits.eases` says, with 0 it brakes."""

    eases: float = 0.0


@dataclass(frozen=True, slots=True)
class Reach:
    """Goal: move to a position and stay there."""

    place: Vector


@dataclass(frozen=True, slots=True)
class Track:
    """Goal: follow a position setpoint by proportional control without shaping (PX4).

    `velocity` is added to the proportional part.
    """

    place: Vector
    velocity: Vector = ZERO


@dataclass(frozen=True, slots=True)
class Keep:
    """Goal: keep a velocity."""

    velocity: Vector


@dataclass(frozen=True, slots=True)
class Orbit:
    """Goal: orbit a position at a distance in m with a speed in m/s, clockwise when positive."""

    centre: Vector
    radius: float
    speed: float


@dataclass(frozen=True, slots=True)
class Lean:
    """Goal: keep an acceleration north and east in m/s2, and a speed downwards."""

    north: float
    east: float
    down: float


@dataclass(frozen=True, slots=True)
class Descend:
    """Goal: straight down to the ground."""


@dataclass(frozen=True, slots=True)
class Rise:
    """Goal: straight up to a height, no faster than a speed in m/s."""

    down: float
    speed: float


@dataclass(frozen=True, slots=True)
class Sink:
    """Goal: descend as with the throttle down, to a hard landing."""


@dataclass(frozen=True, slots=True)
class Fall:
    """Goal of a copter without motors."""


@dataclass(frozen=True, slots=True)
class Roll:
    """Goal of a rover without drive: it rolls out."""


Goal = Rest | Reach | Track | Keep | Orbit | Lean | Rise | Descend | Sink | Fall | Roll
