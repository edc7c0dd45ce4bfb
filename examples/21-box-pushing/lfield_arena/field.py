"""The plane with its objects: robots, which are discs, and a box, prey or a ball. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from lfield_arena.ball import LENGTH, WIDTH, Ball
from lfield_arena.box import MASS, Box, Vector
from lfield_arena.world import PREY_RADIUS, World, along_axes, escape, is_enclosed

#: Metres: radius of a robot; maximum gap of a contact.
RADIUS, TOUCH = 0.15, 0.001
#: Grip of a robot's wheels in N; push for each m/s of speed difference in N per m/s.
GRIP, STIFFNESS = 10.0, 100.0
#: m/s²; the stripe of mud, metres north.
GRAVITY, MUD = 9.81, (1.0, 2.0)
#: Seconds: if there are several prey, a prey that is enclosed for this time is removed.
CAUGHT = 0.5
#: Tolerated overlap in metres; maximum number of iterations for each step.
MAX_OVERLAP, MAX_ITERATIONS = 1e-7, 400
#: Iterations for each step in which a prey moves around robots.
SLIDE_ITERATIONS = 4


@dataclass(slots=True)
class Body:
    """A disc: position, velocity of the wheels in m/s, and remaining share of the grip."""

    place: Vector
    velocity: Vector = (0.0, 0.0)
    radius: float = RADIUS
    grip: float = 1.0


#: Discs, which overlaps move.
Disc = Body | Ball


@dataclass(frozen=True, slots=True)
class Layout:
    """The initial positions on a field: robots by number, and other objects."""

    robots: Mapping[int, Vector]
    box: tuple[float, float, float] | None = None
    prey: tuple[Vector, ...] = ()
    ball: bool = False

    def of_world(self, world: World) -> Layout:
        """The layout for a world, which sets the numbers of predators and prey of a hunt."""
        if not self.prey:
            return self
        return replace(self, robots=world.robots(), prey=tuple(world.prey_places()))


LAYOUTS: Mapping[str, Layout] = {
    "box": Layout({1: (-0.6, -0.9), 2: (-1.0, 0.1), 3: (-0.6, 0.8)}, box=(0.0, 0.0, 0.0)),
    "hunt": Layout({1: (0.0, -1.2), 2: (0.0, -0.4), 3: (0.0, 0.4), 4: (0.0, 1.2)}, prey=((1.6, 0.2),)),
    # Robots 1 to 3 play to the north, robots 4 to 6 to the south.
    "pitch": Layout(
        {1: (-0.6, 0.0), 2: (-1.0, -0.8), 3: (-1.7, 0.0), 4: (0.6, 0.0), 5: (1.0, 0.8), 6: (1.7, 0.0)},
        ball=True,
    ),
}


@dataclass(slots=True)
class Prey(Body):
    """A prey, and the seconds since it was enclosed. A caught prey is removed from the plane."""

    number: int = 0
    enclosed: float = 0.0
    caught: bool = False


@dataclass(slots=True)
class Field:
    """The robots by number, and the other objects. A robot in a collision stops, or is displaced."""

    robots: dict[int, Body]
    box: Box | None = None
    all_prey: list[Prey] = field(default_factory=list)
    ball: Ball | None = None
    world: World = field(default_factory=World)
    #: The sides whose teams are ready for the kick-off.
    ready: set[str] = field(default_factory=set)
    #: Seconds since the start.
    now: float = field(default=0.0)

    @classmethod
    def from_layout(cls, layout: Layout, world: World | None = None) -> Field:
        """The initial field of a layout."""
        world = world or World()
        return cls(
            {number: Body(place) for number, place in layout.robots.items()},
            None if layout.box is None else Box(*layout.box),
            [Prey(place, radius=PREY_RADIUS, number=n) for n, place in enumerate(layout.prey)],
            Ball() if layout.ball else None,
            world,
        )

    @property
    def is_running(self) -> bool:
        """Whether time advances: always without a referee, with a referee after the kick-off."""
        return not self.world.referee or len(self.ready) == 2

    @property
    def free_prey(self) -> list[Prey]:
        """The prey that are not caught."""
        return [prey for prey in self.all_prey if not prey.caught]

    def step(self, seconds: float) -> None:
        """Advances time; before a kick-off no object moves."""
        if not self.is_running:
            return
        self.now += seconds
        hunters = [robot.place for robot in self.robots.values()]
        for prey in self.free_prey:
            prey.velocity = escape(self.world, prey.place, hunters, self.now, prey.number)
        if self.box is not None:
            self._push(self.box, seconds)
        for robot in self.robots.values():
            wheels = along_axes(robot.velocity, self.world.moves)
            robot.place = self.world.inside(_moved(robot.place, wheels, seconds), robot.radius)
        if self.ball is not None:
            self._move_ball(self.ball, seconds)
        self._resolve_overlaps()
        for prey in self.free_prey:
            self._run(prey, seconds)
            if len(self.all_prey) > 1:
                self._catch(prey, seconds)

    @property
    def targets(self) -> list[tuple[float, float, float]]:
        """North, east and heading of the observed objects: box, free prey, or ball."""
        if self.box is not None:
            return [(self.box.north, self.box.east, self.box.heading)]
        if self.ball is not None:
            return [(*self.ball.place, math.atan2(self.ball.speed[1], self.ball.speed[0]))]
        return [(*prey.place, math.atan2(prey.velocity[1], prey.velocity[0])) for prey in self.free_prey]

    @property
    def _bodies(self) -> list[Disc]:
        bodies: list[Disc] = [*self.robots.values(), *self.free_prey]
        if self.ball is not None and not self.ball.pause:
            bodies.append(self.ball)
        return bodies

    def _move_ball(self, ball: Ball, seconds: float) -> None:
        for robot in self.robots.values():
            gap, normal = ball.touch(robot.place, robot.radius)
            if gap < TOUCH and not ball.pause:
                ball.collide(normal, robot.velocity)
        ball.step(seconds)

    def _push(self, box: Box, seconds: float) -> None:
        """Moves the box. A robot pushes in proportion to the difference of speeds, up to its grip."""
        pushes = []
        for robot in self.robots.values():
            contact = box.touch(robot.place, robot.radius)
            if contact.gap < TOUCH:
                target = robot.velocity[0] * contact.normal[0] + robot.velocity[1] * contact.normal[1]
                force = STIFFNESS * (target - box.speed_at(contact))
                pushes.append((contact, min(GRIP * robot.grip, max(0.0, force))))
        mud = self.world.mud if MUD[0] < box.north < MUD[1] else 1.0
        box.step(pushes, seconds, downhill=MASS * GRAVITY * self.world.slope, mud=mud)

    def _catch(self, prey: Prey, seconds: float) -> None:
        """Removes a prey that has been enclosed for CAUGHT seconds."""
        robots = [(robot.place, robot.radius) for robot in self.robots.values()]
        prey.enclosed = prey.enclosed + seconds if is_enclosed(prey.place, robots) else 0.0
        prey.caught = prey.enclosed >= CAUGHT

    def _run(self, prey: Prey, seconds: float) -> None:
        """Moves a prey, which slides along robots, and stops if it would overlap a robot."""
        previous = prey.place
        prey.place = self.world.inside(_moved(previous, prey.velocity, seconds), prey.radius)
        for _ in range(SLIDE_ITERATIONS):
            for robot in self.robots.values():
                distance = math.dist(robot.place, prey.place)
                overlap = robot.radius + prey.radius - distance
                if overlap > 0.0 and distance > 0.0:
                    out = (
                        (prey.place[0] - robot.place[0]) / distance,
                        (prey.place[1] - robot.place[1]) / distance,
                    )
                    prey.place = _moved(prey.place, out, overlap)
        distances = [math.dist(robot.place, prey.place) for robot in self.robots.values()]
        if min(distances, default=math.inf) < RADIUS + PREY_RADIUS - MAX_OVERLAP:
            prey.place = previous

    def _resolve_overlaps(self) -> None:
        """Moves overlapping discs apart, each by one half, and out of the box."""
        bodies = self._bodies
        for _ in range(MAX_ITERATIONS):
            largest = 0.0
            for index, first in enumerate(bodies):
                for second in bodies[index + 1 :]:
                    largest = max(largest, _separate(first, second))
                if self.box is not None:
                    contact = self.box.touch(first.place, first.radius)
                    first.place = _moved(first.place, contact.normal, min(0.0, contact.gap))
                    largest = max(largest, -contact.gap)
            if self.ball is not None:
                self._keep_on_pitch(self.ball)
            if largest < MAX_OVERLAP:
                return

    def _keep_on_pitch(self, ball: Ball) -> None:
        """Keeps the ball and the robots on the pitch. Robots do not enter the goals."""
        for robot in self.robots.values():
            limits = LENGTH / 2.0 - robot.radius, WIDTH / 2.0 - robot.radius
            robot.place = _within(robot.place[0], limits[0]), _within(robot.place[1], limits[1])
        if not ball.pause:
            ball.keep_on_pitch()


def _within(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))


def _separate(first: Disc, second: Disc) -> float:
    """Moves two overlapping discs apart; returns the overlap in metres."""
    north, east = second.place[0] - first.place[0], second.place[1] - first.place[1]
    distance = math.hypot(north, east)
    overlap = first.radius + second.radius - distance
    if overlap > 0.0:
        direction = (north / distance, east / distance) if distance > 0.0 else (1.0, 0.0)
        first.place = _moved(first.place, direction, -overlap / 2.0)
        second.place = _moved(second.place, direction, overlap / 2.0)
    return overlap


def _moved(place: Vector, direction: Vector, metres: float) -> Vector:
    return place[0] + direction[0] * metres, place[1] + direction[1] * metres
