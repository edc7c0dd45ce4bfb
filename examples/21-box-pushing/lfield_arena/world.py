"""The world: size of a plane, numbers, legal moves, intelligence of the prey, terrain. Pure.

The bindings of all robots of a plane have the same text: `world: "size=6 prey=2 mind=random"`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import get_type_hints

from lfield_arena.box import Vector

#: The prey: radius, visual range and flight distance in metres, speed in m/s.
PREY_RADIUS, VISUAL_RANGE, FLIGHT_DISTANCE, PREY_SPEED = 0.2, 2.5, 1.2, 0.3
#: Metres: a prey flees from nearer walls, even if no robot is near.
WALL_DISTANCE = 0.7
#: Seconds between two turns of a prey that moves at random.
TURN_INTERVAL = 1.0
MINDS = ("still", "random", "away", "gap")


@dataclass(frozen=True, slots=True)
class World:
    """The properties of a plane; the defaults are those of the standard plane.

    `size` is the side of a square with walls in metres, 0 for an open plane. `moves` and `prey_moves` are the
    numbers of directions in which robots and prey can move, 0 for any and 4 for north, east, south, west.
    The `mind` of a prey: it stands `still`, moves at `random`, flees `away` from the nearest robot, or flees
    to the widest `gap` between robots. `slope` is the gradient of the floor, downwards to the east. `mud`
    multiplies the friction of a box in the stripe from 1 m to 2 m north. With a `referee`, a match starts
    when both teams are ready. `port` is the port of the plane on this computer; 0: the default port.
    """

    size: float = 0.0
    predators: int = 4
    prey: int = 1
    mind: str = "gap"
    moves: int = 0
    prey_moves: int = 0
    seed: int = 0
    slope: float = 0.0
    mud: float = 1.0
    referee: int = 0
    port: int = 0

    @classmethod
    def parse(cls, text: str) -> World:
        """Parses a text of `name=value` pairs. Raises ValueError."""
        kinds, values = get_type_hints(cls), {}
        for part in text.split():
            name, _, value = part.partition("=")
            if name not in kinds:
                raise ValueError(f"a world has no {name!r}; it has {', '.join(f.name for f in fields(cls))}")
            values[name] = kinds[name](value)
        world = replace(cls(), **values)
        if world.mind not in MINDS:
            raise ValueError(f"no prey has the mind {world.mind!r}; there are {', '.join(MINDS)}")
        if {world.moves, world.prey_moves} - {0, 4} or not (
            1 <= world.predators <= 9 and 1 <= world.prey <= 9
        ):
            raise ValueError("moves are 0 or 4, predators and prey 1 to 9")
        return world

    def robots(self) -> dict[int, Vector]:
        """The initial positions of the predators, by number: in a line from west to east."""
        north = -self.size / 4.0
        return {n: (north, 0.8 * (n - (self.predators + 1) / 2.0)) for n in range(1, self.predators + 1)}

    def prey_places(self) -> list[Vector]:
        """The initial positions of the prey, north of the robots; they depend on the seed."""
        places = []
        for number in range(self.prey):
            turn = 2.399963 * (self.seed + 3 * number)
            spread = 0.0 if self.seed == number == 0 else 0.5
            place = 1.6 + spread * math.cos(turn) + 0.6 * number, 0.2 + 2.0 * spread * math.sin(turn)
            places.append(self.inside((place[0] - self.size / 4.0, place[1]), PREY_RADIUS + 0.5))
        return places

    def inside(self, place: Vector, radius: float) -> Vector:
        """The nearest position within the walls."""
        limit = self.size / 2.0 - radius if self.size else math.inf
        return min(limit, max(-limit, place[0])), min(limit, max(-limit, place[1]))


def along_axes(velocity: Vector, moves: int) -> Vector:
    """A velocity with the same speed in the nearest permitted direction."""
    if not moves or velocity == (0.0, 0.0):
        return velocity
    speed = math.hypot(*velocity)
    if abs(velocity[0]) >= abs(velocity[1]):
        return math.copysign(speed, velocity[0]), 0.0
    return 0.0, math.copysign(speed, velocity[1])


def escape(world: World, place: Vector, hunters: Sequence[Vector], now: float, number: int) -> Vector:
    """The velocity of a prey in m/s, according to its mind; moving prey avoid walls."""
    walls = _near_walls(world, place)
    if world.mind == "still":
        return 0.0, 0.0
    if world.mind == "random":
        turn = 2.399963 * (world.seed + 7 * number + int(now / TURN_INTERVAL) ** 2)
        velocity = PREY_SPEED * math.cos(turn), PREY_SPEED * math.sin(turn)
        return along_axes(flight(place, walls) if walls else velocity, world.prey_moves)
    if world.mind == "away":
        nearest = sorted(hunters, key=lambda hunter: math.dist(hunter, place))[:1]
        return along_axes(flight(place, [*nearest, *walls]), world.prey_moves)
    return along_axes(flight(place, [*hunters, *walls]), world.prey_moves)


def _near_walls(world: World, place: Vector) -> list[Vector]:
    """The nearest points of the walls that a prey avoids."""
    edge = world.size / 2.0
    if not edge:
        return []
    points = [(edge, place[1]), (-edge, place[1]), (place[0], edge), (place[0], -edge)]
    return [point for point in points if math.dist(point, place) < WALL_DISTANCE]


def flight(place: Vector, hunters: Sequence[Vector]) -> Vector:
    """The velocity of a prey in m/s: to the middle of the widest gap between the visible hunters."""
    visible = [
        (hunter[0] - place[0], hunter[1] - place[1])
        for hunter in hunters
        if math.dist(hunter, place) < VISUAL_RANGE
    ]
    if all(math.hypot(*offset) > FLIGHT_DISTANCE for offset in visible):
        return 0.0, 0.0
    angles = sorted(math.atan2(east, north) for north, east in visible)
    ends = [*angles[1:], angles[0] + math.tau]
    gap, start = max((end - start, start) for start, end in zip(angles, ends, strict=True))
    return PREY_SPEED * math.cos(start + gap / 2.0), PREY_SPEED * math.sin(start + gap / 2.0)


def is_enclosed(place: Vector, robots: Sequence[tuple[Vector, float]]) -> bool:
    """Whether robots (position and radius) surround a prey, without a gap that is wide enough for it."""
    around = sorted(robots, key=lambda robot: math.atan2(robot[0][1] - place[1], robot[0][0] - place[0]))
    for (first, radius), (second, other_radius) in zip(around, [*around[1:], *around[:1]], strict=True):
        first_bearing = math.atan2(first[1] - place[1], first[0] - place[0])
        turn = (math.atan2(second[1] - place[1], second[0] - place[0]) - first_bearing) % math.tau
        if turn >= math.pi or math.dist(first, second) - radius - other_radius >= 2.0 * PREY_RADIUS:
            return False
    return len(around) > 2
