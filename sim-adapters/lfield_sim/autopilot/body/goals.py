"""What a vehicle is to do, as data: the goals of its motion."""

from __future__ import annotations

from dataclasses import dataclass

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Rest:
    """Goal: stay where you are; the last of the speed goes as `Limits.eases` says, with 0 it brakes on."""

    eases: float = 0.0


@dataclass(frozen=True, slots=True)
class Reach:
    """Goal: go to a place and stay there."""

    place: Vector


@dataclass(frozen=True, slots=True)
class Track:
    """Goal: follow the place of a setpoint by proportional control, which shapes no step of it (PX4).

    `velocity` is added to what the distance asks for.
    """

    place: Vector
    velocity: Vector = ZERO


@dataclass(frozen=True, slots=True)
class Keep:
    """Goal: keep a velocity."""

    velocity: Vector


@dataclass(frozen=True, slots=True)
class Circle:
    """Goal: fly round a place at a distance in m with a speed in m/s, clockwise when it is positive."""

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
    """Goal: come down as with the throttle down, to the ground and hard."""


@dataclass(frozen=True, slots=True)
class Fall:
    """Goal of a copter without motors."""


@dataclass(frozen=True, slots=True)
class Roll:
    """Goal of a rover that nothing drives: it rolls out."""


Goal = Rest | Reach | Track | Keep | Circle | Lean | Rise | Descend | Sink | Fall | Roll
