"""A ball on a pitch with walls and two goals: it rolls, bounces and is kicked. Pure.

The pitch is an indoor pitch with walls. The goals are gaps in the middle of the north and south walls. Metres
north and east of the middle, m/s, seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lfield_arena.box import Vector

#: Length and width of the pitch, and width of a goal.
LENGTH, WIDTH, GOAL = 4.0, 3.0, 1.0
#: Radius of the ball; maximum distance for a kick, between the rims; maximum speed of a kick.
BALL_RADIUS, REACH, HARDEST = 0.06, 0.05, 2.0
#: Relative loss of speed per second by rolling; restitution of walls and robots.
ROLLING_FRICTION, WALL, BUMPER = 0.4, 0.6, 0.3
#: Seconds in a goal; if it moves less than so many metres in so many seconds, it is put into the middle.
PAUSE, PROGRESS, PATIENCE = 3.0, 0.2, 4.0


@dataclass(slots=True)
class Ball:
    """A ball, and its numbers of goals in the north and in the south."""

    place: Vector = (0.0, 0.0)
    speed: Vector = (0.0, 0.0)
    radius: float = BALL_RADIUS
    goals: list[int] = field(default_factory=lambda: [0, 0])
    #: Remaining seconds in a goal; 0 in play.
    rests: float = 0.0
    #: A position near which it has stayed, and for how long.
    mark: Vector = (0.0, 0.0)
    stuck: float = 0.0

    def step(self, seconds: float) -> None:
        """Advances time."""
        if self.rests > 0.0:
            self._rest(seconds)
            return
        fast = math.hypot(*self.speed)
        left = max(0.0, 1.0 - ROLLING_FRICTION * seconds / fast) if fast > 0.0 else 0.0
        self.speed = self.speed[0] * left, self.speed[1] * left
        self.place = self.place[0] + self.speed[0] * seconds, self.place[1] + self.speed[1] * seconds
        self.hold()
        if abs(self.place[0]) > LENGTH / 2.0 + self.radius:
            self.goals[self.place[0] < 0.0] += 1
            self.speed, self.rests = (0.0, 0.0), PAUSE
        self._progress(seconds)

    def _rest(self, seconds: float) -> None:
        self.rests = max(0.0, self.rests - seconds)
        if self.rests == 0.0:
            self.place = (0.0, 0.0)

    def _progress(self, seconds: float) -> None:
        self.stuck += seconds
        if math.dist(self.place, self.mark) > PROGRESS:
            self.mark, self.stuck = self.place, 0.0
        if self.stuck > PATIENCE:
            self.place, self.speed, self.stuck = (0.0, 0.0), (0.0, 0.0), 0.0

    def hold(self) -> None:
        """Puts it back inside the walls, bouncing; between the posts there is no wall."""
        beyond = abs(self.place[0]) - (LENGTH / 2.0 - self.radius)
        sideways = abs(self.place[1]) - (GOAL / 2.0 - self.radius)
        if beyond > 0.0 and sideways > 0.0:
            self._wall(0, beyond) if beyond < sideways else self._wall(1, sideways)
        self._wall(1, abs(self.place[1]) - (WIDTH / 2.0 - self.radius))

    def _wall(self, axis: int, overlap: float) -> None:
        if overlap <= 0.0:
            return
        place, speed = list(self.place), list(self.speed)
        out = math.copysign(1.0, place[axis])
        place[axis] -= out * overlap
        if speed[axis] * out > 0.0:
            speed[axis] *= -WALL
        self.place, self.speed = (place[0], place[1]), (speed[0], speed[1])

    def touch(self, place: Vector, radius: float) -> tuple[float, Vector]:
        """Distance to a disc in metres, and the direction from the disc to it."""
        north, east = self.place[0] - place[0], self.place[1] - place[1]
        away = math.hypot(north, east)
        return away - radius - self.radius, (north / away, east / away) if away > 0.0 else (1.0, 0.0)

    def struck(self, normal: Vector, speed: Vector) -> None:
        """A collision with an object that moves with that speed."""
        closing = sum(
            (theirs - own) * along for theirs, own, along in zip(speed, self.speed, normal, strict=True)
        )
        gained = max(0.0, closing) * (1.0 + BUMPER)
        self.speed = self.speed[0] + normal[0] * gained, self.speed[1] + normal[1] * gained

    def kicked(self, place: Vector, radius: float, speed: float) -> bool:
        """A kick by a disc, straight away from it. False when it is too far away."""
        gap, normal = self.touch(place, radius)
        if gap > REACH or self.rests > 0.0:
            return False
        speed = min(HARDEST, max(0.0, speed))
        self.speed = normal[0] * speed, normal[1] * speed
        return True
