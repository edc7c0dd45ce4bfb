"""Wind and its effect on a flying vehicle.

A copter leans against wind up to its tilt limit; the rest moves it along. Its drag is quadratic in its
airspeed and equals its weight at REFERENCE m/s, where it leans by 45 degrees (the frame of ArduPilot's
simulator, refSpd and refAngle). The motion constants of each autopilot were measured in still air and include
its drag, so only the addition by wind counts here. Speeds in m/s, accelerations in m/s2, north and east;
angles in radians.
"""

from __future__ import annotations

import math
from random import Random

from msgspec import Struct, field

GRAVITY = 9.80665
#: m/s at which the drag of a copter equals its weight.
REFERENCE = 15.0
#: Seconds in which an autopilot compensates two thirds of a push.
ANSWERS = 1.0
#: Maximum lean.
STEEPEST = math.radians(80.0)
#: Seconds of a gust and of the pause after it; least share of `Wind.gusts` in one.
GUST, PAUSE, WEAKEST = (2.0, 6.0), (1.0, 6.0), 0.3

Level = tuple[float, float]
Vector = tuple[float, float, float]
CALM: Level = (0.0, 0.0)


class Wind(Struct):
    """The wind at one vehicle: steady `speed` from `source`, clockwise from north, and up to `gusts` more.

    Gusts come at random by `rng`, each with the 1 - cos profile (MIL-F-8785C). `push` is its present
    acceleration, `load` its power relative to still air.
    """

    speed: float = 0.0
    source: float = 0.0
    gusts: float = 0.0
    rng: Random = field(default_factory=lambda: Random(1))
    push: Level = CALM
    load: float = 1.0
    _compensated: Level = CALM
    _age: float = 0.0
    _lasts: float = 0.0
    _pause: float = 0.0
    _share: float = 0.0

    def step(self, dt: float) -> None:
        """Advances time by `dt` seconds."""
        self._age += dt
        if self._age >= self._lasts + self._pause:
            self._age, self._lasts = 0.0, self.rng.uniform(*GUST)
            self._share, self._pause = self.rng.uniform(WEAKEST, 1.0), self.rng.uniform(*PAUSE)

    @property
    def velocity(self) -> Level:
        """Direction and speed of the air."""
        speed = self.speed
        if self._age < self._lasts:
            speed += self.gusts * self._share * 0.5 * (1.0 - math.cos(math.tau * self._age / self._lasts))
        return (-speed * math.cos(self.source), -speed * math.sin(self.source)) if speed else CALM

    @property
    def blows(self) -> bool:
        """Whether the wind or its gusts are above 0."""
        return self.speed > 0.0 or self.gusts > 0.0

    def airspeed(self, velocity: Vector) -> float:
        """The airspeed for a velocity over ground."""
        north, east = self.velocity
        return math.hypot(velocity[0] - north, velocity[1] - east)

    @property
    def residual(self) -> Level:
        """The uncompensated push, added to every commanded acceleration."""
        return (self.push[0] - self._compensated[0], self.push[1] - self._compensated[1])

    def apply(self, velocity: Vector, dt: float, *, flies: bool, drifts: bool) -> None:
        """Pushes for `dt` seconds; a vehicle that `drifts` with the wind does not lean."""
        air = self.velocity
        self.push, self.load = CALM, 1.0
        if flies and air != CALM:
            still = _drag(-velocity[0], -velocity[1])
            blown = _drag(air[0] - velocity[0], air[1] - velocity[1])
            self.push = (blown[0] - still[0], blown[1] - still[1])
        residual, gain = self.residual, min(1.0, dt / ANSWERS)
        leans = flies and not drifts
        self._compensated = (
            (self._compensated[0] + residual[0] * gain, self._compensated[1] + residual[1] * gain)
            if leans
            else CALM
        )

    def actual_acceleration(self, target: Level, velocity: Vector, tilt: float) -> Level:
        """The actual acceleration for a commanded one, with the lean by `tilt` for it and the wind.

        The lean of still air is always available.
        """
        if self.push == self._compensated == CALM:
            return target
        still = _drag(-velocity[0], -velocity[1])
        calm = (target[0] - still[0], target[1] - still[1])
        lean = (calm[0] - self._compensated[0], calm[1] - self._compensated[1])
        limit = max(math.tan(min(tilt, STEEPEST)) * GRAVITY, math.hypot(*calm))
        share = min(1.0, limit / math.hypot(*lean)) if any(lean) else 1.0
        # Rotor power grows with thrust to the power 1.5 (momentum theory).
        thrust = math.hypot(GRAVITY, lean[0] * share, lean[1] * share)
        self.load = (thrust / math.hypot(GRAVITY, *calm)) ** 1.5
        residual, lost_share = self.residual, 1.0 - share
        return (
            target[0] + residual[0] - lean[0] * lost_share,
            target[1] + residual[1] - lean[1] * lost_share,
        )


def _drag(north: float, east: float) -> Level:
    """The acceleration by air that passes with this velocity."""
    factor = GRAVITY * math.hypot(north, east) / REFERENCE**2
    return (north * factor, east * factor)
