"""Wind: how the air moves about a vehicle, and what it does to one that flies.

A copter leans against wind, as far as it may lean; what is more takes it along. Its drag grows with the
square of its airspeed, and is as much as its weight at REFERENCE m/s: leaning by 45 degrees it could stand in
that (the frame of ArduPilot's simulator, refSpd and refAngle). The constants of motion of each autopilot were
measured in still air and have its drag in them, so only what wind adds to it counts here: without wind all of
this is nothing. Speeds in m/s, accelerations in m/s2, north and east; angles in radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from random import Random

GRAVITY = 9.80665
#: m/s at which the drag of a copter is as much as its weight.
REFERENCE = 15.0
#: Seconds in which an autopilot comes to lean against two thirds of a push: its controllers are no quicker.
ANSWERS = 1.0
#: Nobody leans further than this.
STEEPEST = math.radians(80.0)
#: Seconds that a gust and the pause after it last; the least share of `Wind.gusts` that one has.
GUST, PAUSE, WEAKEST = (2.0, 6.0), (1.0, 6.0), 0.3

Level = tuple[float, float]
Vector = tuple[float, float, float]
CALM: Level = (0.0, 0.0)


@dataclass(slots=True)
class Wind:
    """The wind at one vehicle: steady `speed` from `source`, clockwise from north, and `gusts` more at most.

    Gusts come one after another by `dice`, each of the form 1 - cos (MIL-F-8785C, by which aircraft are
    tried). `push` is what wind does to it now, `load` how many times as much as in still air it draws.
    """

    speed: float = 0.0
    source: float = 0.0
    gusts: float = 0.0
    dice: Random = field(default_factory=lambda: Random(1))
    push: Level = CALM
    load: float = 1.0
    _borne: Level = CALM
    _age: float = 0.0
    _lasts: float = 0.0
    _pause: float = 0.0
    _share: float = 0.0

    def step(self, dt: float) -> None:
        """Let `dt` seconds pass."""
        self._age += dt
        if self._age >= self._lasts + self._pause:
            self._age, self._lasts = 0.0, self.dice.uniform(*GUST)
            self._share, self._pause = self.dice.uniform(WEAKEST, 1.0), self.dice.uniform(*PAUSE)

    @property
    def velocity(self) -> Level:
        """Where the air goes, and how fast."""
        speed = self.speed
        if self._age < self._lasts:
            speed += self.gusts * self._share * 0.5 * (1.0 - math.cos(math.tau * self._age / self._lasts))
        return (-speed * math.cos(self.source), -speed * math.sin(self.source)) if speed else CALM

    @property
    def blows(self) -> bool:
        """Whether there is any, or may be soon."""
        return self.speed > 0.0 or self.gusts > 0.0

    def airspeed(self, velocity: Vector) -> float:
        """How fast the air passes by one that has this velocity over ground."""
        north, east = self.velocity
        return math.hypot(velocity[0] - north, velocity[1] - east)

    @property
    def left(self) -> Level:
        """What it does not lean against yet: it comes on top of every acceleration that is wanted."""
        return (self.push[0] - self._borne[0], self.push[1] - self._borne[1])

    def meet(self, velocity: Vector, dt: float, *, flies: bool, goes: bool) -> None:
        """Push for `dt` seconds; one that `goes` with the wind leans against nothing."""
        air = self.velocity
        self.push, self.load = CALM, 1.0
        if flies and air != CALM:
            still = _drag(-velocity[0], -velocity[1])
            blown = _drag(air[0] - velocity[0], air[1] - velocity[1])
            self.push = (blown[0] - still[0], blown[1] - still[1])
        left, more = self.left, min(1.0, dt / ANSWERS)
        leans = flies and not goes
        self._borne = (self._borne[0] + left[0] * more, self._borne[1] + left[1] * more) if leans else CALM

    def bear(self, wanted: Level, velocity: Vector, tilt: float) -> Level:
        """What comes of an acceleration over ground that is wanted; for it and the wind it leans by `tilt`.

        As far as it would lean in still air it may do so in any case.
        """
        if self.push == self._borne == CALM:
            return wanted
        still = _drag(-velocity[0], -velocity[1])
        calm = (wanted[0] - still[0], wanted[1] - still[1])
        lean = (calm[0] - self._borne[0], calm[1] - self._borne[1])
        most = max(math.tan(min(tilt, STEEPEST)) * GRAVITY, math.hypot(*calm))
        share = min(1.0, most / math.hypot(*lean)) if any(lean) else 1.0
        # The power that a rotor takes is that of its thrust, to the 1.5 (momentum theory).
        thrust = math.hypot(GRAVITY, lean[0] * share, lean[1] * share)
        self.load = (thrust / math.hypot(GRAVITY, *calm)) ** 1.5
        left, lost = self.left, 1.0 - share
        return (wanted[0] + left[0] - lean[0] * lost, wanted[1] + left[1] - lean[1] * lost)


def _drag(north: float, east: float) -> Level:
    """The acceleration by air that passes with this velocity."""
    each = GRAVITY * math.hypot(north, east) / REFERENCE**2
    return (north * each, east * each)
