"""The plane with its objects: robots, which are discs, and a box, a prey or a ball. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from lfield_arena.ball import LENGTH, WIDTH, Ball
from lfield_arena.box import Box, Vector

#: Metres: radius of a robot, and distance at which it touches the box.
RADIUS, TOUCH = 0.15, 0.001
#: Grip of a robot's wheels in newtons, and force per speed deficit in N per m/s.
GRIP, STIFFNESS = 10.0, 100.0
#: The prey: its radius, range of sight and flight distance in metres, and its speed in m/s.
PREY_RADIUS, VISUAL_RANGE, NEAR, PREY_SPEED = 0.2, 2.5, 1.2, 0.3
#: Tolerated overlap in metres; maximum iterations per step.
EXACT, SWEEPS = 1e-7, 400
#: Iterations per step in which a prey avoids robots.
SLIDES = 4


@dataclass(slots=True)
class Body:
    """A disc: position, velocity of its wheels in m/s, and share of its grip."""

    place: Vector
    velocity: Vector = (0.0, 0.0)
    radius: float = RADIUS
    grip: float = 1.0


#: Objects that yield to others.
Disc = Body | Ball


@dataclass(frozen=True, slots=True)
class Layout:
    """The initial state of a field: robots by number, and other objects."""

    robots: Mapping[int, Vector]
    box: tuple[float, float, float] | None = None
    prey: Vector | None = None
    ball: bool = False


LAYOUTS: Mapping[str, Layout] = {
    "box": Layout({1: (-0.6, -0.9), 2: (-1.0, 0.1), 3: (-0.6, 0.8)}, box=(0.0, 0.0, 0.0)),
    "hunt": Layout({1: (0.0, -1.2), 2: (0.0, -0.4), 3: (0.0, 0.4), 4: (0.0, 1.2)}, prey=(1.6, 0.2)),
    # One to three play to the north, four to six to the south.
    "pitch": Layout(
        {1: (-0.6, 0.0), 2: (-1.0, -0.8), 3: (-1.7, 0.0), 4: (0.6, 0.0), 5: (1.0, 0.8), 6: (1.7, 0.0)},
        ball=True,
    ),
}


@dataclass(slots=True)
class Field:
    """Robots by number. Collisions do not turn wheels: a robot stops, or is pushed away."""

    robots: dict[int, Body]
    box: Box | None = None
    prey: Body | None = None
    ball: Ball | None = None
    #: Seconds since the start.
    now: float = field(default=0.0)

    @classmethod
    def of(cls, layout: Layout) -> Field:
        """The initial field."""
        return cls(
            {number: Body(place) for number, place in layout.robots.items()},
            None if layout.box is None else Box(*layout.box),
            None if layout.prey is None else Body(layout.prey, radius=PREY_RADIUS),
            Ball() if layout.ball else None,
        )

    def step(self, seconds: float) -> None:
        """Advances time."""
        self.now += seconds
        if self.prey is not None:
            self.prey.velocity = flight(self.prey.place, [robot.place for robot in self.robots.values()])
        if self.box is not None:
            self._push(self.box, seconds)
        for robot in self.robots.values():
            robot.place = _moved(robot.place, robot.velocity, seconds)
        if self.ball is not None:
            self._move_ball(self.ball, seconds)
        self._part()
        if self.prey is not None:
            self._run(self.prey, seconds)

    @property
    def target(self) -> tuple[float, float, float]:
        """The robots' object: north, east and heading of the box, the prey or the ball."""
        if self.box is not None:
            return self.box.north, self.box.east, self.box.heading
        if self.prey is not None:
            return *self.prey.place, math.atan2(self.prey.velocity[1], self.prey.velocity[0])
        if self.ball is not None:
            return *self.ball.place, math.atan2(self.ball.speed[1], self.ball.speed[0])
        return 0.0, 0.0, 0.0

    @property
    def _bodies(self) -> list[Disc]:
        there: list[Disc] = [*self.robots.values()]
        if self.prey is not None:
            there.append(self.prey)
        if self.ball is not None and not self.ball.rests:
            there.append(self.ball)
        return there

    def _move_ball(self, ball: Ball, seconds: float) -> None:
        for robot in self.robots.values():
            gap, normal = ball.touch(robot.place, robot.radius)
            if gap < TOUCH and not ball.rests:
                ball.struck(normal, robot.velocity)
        ball.step(seconds)

    def _push(self, box: Box, seconds: float) -> None:
        """Wheels push in proportion to their speed deficit, up to their grip; stationary ones hold."""
        pushes = []
        for robot in self.robots.values():
            contact = box.touch(robot.place, robot.radius)
            if contact.gap < TOUCH:
                target = robot.velocity[0] * contact.normal[0] + robot.velocity[1] * contact.normal[1]
                lacking = STIFFNESS * (target - box.speed_at(contact))
                pushes.append((contact, min(GRIP * robot.grip, max(0.0, lacking))))
        box.step(pushes, seconds)

    def _run(self, prey: Body, seconds: float) -> None:
        """Moves the prey: it pushes no robot, slides along obstacles, and stops if it cannot."""
        before = prey.place
        prey.place = _moved(before, prey.velocity, seconds)
        for _ in range(SLIDES):
            for robot in self.robots.values():
                away = math.dist(robot.place, prey.place)
                overlap = robot.radius + prey.radius - away
                if overlap > 0.0 and away > 0.0:
                    out = (prey.place[0] - robot.place[0]) / away, (prey.place[1] - robot.place[1]) / away
                    prey.place = _moved(prey.place, out, overlap)
        least = [math.dist(robot.place, prey.place) for robot in self.robots.values()]
        if min(least, default=math.inf) < RADIUS + PREY_RADIUS - EXACT:
            prey.place = before

    def _part(self) -> None:
        """Resolves overlaps: discs yield to each other by halves, and to the box."""
        bodies = self._bodies
        for _ in range(SWEEPS):
            worst = 0.0
            for index, one in enumerate(bodies):
                for other in bodies[index + 1 :]:
                    worst = max(worst, _apart(one, other))
                if self.box is not None:
                    contact = self.box.touch(one.place, one.radius)
                    one.place = _moved(one.place, contact.normal, min(0.0, contact.gap))
                    worst = max(worst, -contact.gap)
            if self.ball is not None:
                self._wall_in(self.ball)
            if worst < EXACT:
                return

    def _wall_in(self, ball: Ball) -> None:
        """Keeps robots on the pitch, also in front of the goals, and the ball."""
        for robot in self.robots.values():
            most = LENGTH / 2.0 - robot.radius, WIDTH / 2.0 - robot.radius
            robot.place = _within(robot.place[0], most[0]), _within(robot.place[1], most[1])
        if not ball.rests:
            ball.hold()


def _within(value: float, most: float) -> float:
    return min(most, max(-most, value))


def _apart(one: Disc, other: Disc) -> float:
    """Moves two overlapping discs apart; returns the overlap in metres."""
    north, east = other.place[0] - one.place[0], other.place[1] - one.place[1]
    away = math.hypot(north, east)
    overlap = one.radius + other.radius - away
    if overlap > 0.0:
        along = (north / away, east / away) if away > 0.0 else (1.0, 0.0)
        one.place = _moved(one.place, along, -overlap / 2.0)
        other.place = _moved(other.place, along, overlap / 2.0)
    return overlap


def _moved(place: Vector, along: Vector, metres: float) -> Vector:
    return place[0] + along[0] * metres, place[1] + along[1] * metres


def flight(place: Vector, hunters: Sequence[Vector]) -> Vector:
    """The velocity of a prey in m/s: to the middle of the widest gap between the hunters that it sees."""
    visible = [
        (hunter[0] - place[0], hunter[1] - place[1])
        for hunter in hunters
        if math.dist(hunter, place) < VISUAL_RANGE
    ]
    if all(math.hypot(*way) > NEAR for way in visible):
        return 0.0, 0.0
    angles = sorted(math.atan2(east, north) for north, east in visible)
    ends = [*angles[1:], angles[0] + math.tau]
    gap, start = max((end - start, start) for start, end in zip(angles, ends, strict=True))
    return PREY_SPEED * math.cos(start + gap / 2.0), PREY_SPEED * math.sin(start + gap / 2.0)
