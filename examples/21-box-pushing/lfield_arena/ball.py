"""The physics of a ball on a pitch with walls and two goals: rolling, bouncing, kicks. Pure.

The goals are gaps in the middle of the north and south walls. Positions are metres north and east of the
centre, speeds m/s, times seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lfield_arena.box import Vector

#: Length and width of the pitch, and width of a goal.
LENGTH, WIDTH, GOAL = 4.0, 3.0, 1.0
#: Radius of the ball; maximum distance of the rims for a kick; maximum speed of a kick.
BALL_RADIUS, REACH, MAX_KICK_SPEED = 0.06, 0.05, 2.0
#: Relative loss of speed per second by rolling; restitution of walls and robots.
ROLLING_FRICTION, WALL, BUMPER = 0.4, 0.6, 0.3
#: Seconds that a ball stays in a goal. A ball that moves less than STUCK_DISTANCE in STUCK_TIME is stuck, and
#: is put into the centre.
PAUSE, STUCK_DISTANCE, STUCK_TIME = 3.0, 0.2, 4.0


@dataclass(slots=True)
class Ball:
    """A ball, and the numbers of goals in the north and in the south."""

    place: Vector = (0.0, 0.0)
    speed: Vector = (0.0, 0.0)
    radius: float = BALL_RADIUS
    goals: list[int] = field(default_factory=lambda: [0, 0])
    #: Remaining seconds in a goal; 0 in play.
    pause: float = 0.0
    #: The position of the last progress, and the seconds since then.
    mark: Vector = (0.0, 0.0)
    stuck: float = 0.0

    def step(self, seconds: float) -> None:
        """Advances time."""
        if self.pause > 0.0:
            self._wait_in_goal(seconds)
            return
        speed = math.hypot(*self.speed)
        factor = max(0.0, 1.0 - ROLLING_FRICTION * seconds / speed) if speed > 0.0 else 0.0
        self.speed = self.speed[0] * factor, self.speed[1] * factor
        self.place = self.place[0] + self.speed[0] * seconds, self.place[1] + self.speed[1] * seconds
        self.keep_on_pitch()
        if abs(self.place[0]) > LENGTH / 2.0 + self.radius:
            self.goals[self.place[0] < 0.0] += 1
            self.speed, self.pause = (0.0, 0.0), PAUSE
        self._progress(seconds)

    def _wait_in_goal(self, seconds: float) -> None:
        self.pause = max(0.0, self.pause - seconds)
        if self.pause == 0.0:
            self.place = (0.0, 0.0)

    def _progress(self, seconds: float) -> None:
        self.stuck += seconds
        if math.dist(self.place, self.mark) > STUCK_DISTANCE:
            self.mark, self.stuck = self.place, 0.0
        if self.stuck > STUCK_TIME:
            self.place, self.speed, self.stuck = (0.0, 0.0), (0.0, 0.0), 0.0

    def keep_on_pitch(self) -> None:
        """Keeps the ball inside the walls, where it bounces; between the posts there is no wall."""
        overrun = abs(self.place[0]) - (LENGTH / 2.0 - self.radius)
        sideways = abs(self.place[1]) - (GOAL / 2.0 - self.radius)
        if overrun > 0.0 and sideways > 0.0:
            self._wall(0, overrun) if overrun < sideways else self._wall(1, sideways)
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
        """Distance to a disc in metres, and the direction from the disc to the ball."""
        north, east = self.place[0] - place[0], self.place[1] - place[1]
        distance = math.hypot(north, east)
        normal = (north / distance, east / distance) if distance > 0.0 else (1.0, 0.0)
        return distance - radius - self.radius, normal

    def collide(self, normal: Vector, speed: Vector) -> None:
        """Changes the speed in a collision with a moving object."""
        closing = (speed[0] - self.speed[0]) * normal[0] + (speed[1] - self.speed[1]) * normal[1]
        gain = max(0.0, closing) * (1.0 + BUMPER)
        self.speed = self.speed[0] + normal[0] * gain, self.speed[1] + normal[1] * gain

    def kick(self, place: Vector, radius: float, speed: float) -> bool:
        """Kicks the ball straight away from a disc. False if the ball is too far away."""
        gap, normal = self.touch(place, radius)
        if gap > REACH or self.pause > 0.0:
            return False
        speed = min(MAX_KICK_SPEED, max(0.0, speed))
        self.speed = normal[0] * speed, normal[1] * speed
        return True
