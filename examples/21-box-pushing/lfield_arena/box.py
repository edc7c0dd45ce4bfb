"""The physics of a box on the floor: mass, friction, and pushing robots. Pure.

The friction is a *limit surface* (Goyal, Ruina and Papadopoulos, 1991): the set of forces and torques that
friction can balance. Here the surface is a sphere over force, and torque divided by the radius of gyration. A
box at rest does not move while the push is inside the surface. On a sliding box, the maximum friction acts
against the motion. So unequal pushes turn the box.

Positions are north and east in metres, headings in radians from north to east. In the box's frame, `ahead` is
along the heading, and `aside` is to the right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Vector = tuple[float, float]

#: Sides of the box in metres, along and across the heading; mass in kg; friction in newtons.
LENGTH, WIDTH, MASS, FRICTION = 0.4, 1.2, 10.0, 12.0
#: Radius of gyration in metres, that of a plate.
GYRATION = math.hypot(LENGTH, WIDTH) / math.sqrt(12.0)


@dataclass(frozen=True, slots=True)
class Contact:
    """The point of the box that is nearest to a disc.

    `gap` is in metres, negative for an overlap. `normal` points from the disc into the box. `lever` is the
    lever arm in metres of a push along the normal.
    """

    gap: float
    normal: Vector
    lever: float


@dataclass(slots=True)
class Box:
    """A box: pose, speed in m/s, and spin in rad/s."""

    north: float
    east: float
    heading: float
    speed: Vector = (0.0, 0.0)
    spin: float = 0.0

    @property
    def energy(self) -> float:
        """The kinetic energy in joules."""
        return 0.5 * MASS * (math.hypot(*self.speed) ** 2 + (GYRATION * self.spin) ** 2)

    def touch(self, place: Vector, radius: float) -> Contact:
        """The contact with a disc."""
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        north, east = place[0] - self.north, place[1] - self.east
        ahead, aside = north * cos + east * sin, east * cos - north * sin
        nearest = _clamp(ahead, LENGTH / 2.0), _clamp(aside, WIDTH / 2.0)
        distance = math.hypot(ahead - nearest[0], aside - nearest[1])
        if distance > 0.0:
            inward = (nearest[0] - ahead) / distance, (nearest[1] - aside) / distance
        else:
            # The centre of the disc is inside the box: the normal is that of the nearest side.
            depth = LENGTH / 2.0 - abs(ahead), WIDTH / 2.0 - abs(aside)
            distance = -min(depth)
            out = depth[0] < depth[1]
            inward = (-math.copysign(1.0, ahead), 0.0) if out else (0.0, -math.copysign(1.0, aside))
        lever = nearest[0] * inward[1] - nearest[1] * inward[0]
        normal = inward[0] * cos - inward[1] * sin, inward[0] * sin + inward[1] * cos
        return Contact(distance - radius, normal, lever)

    def speed_at(self, contact: Contact) -> float:
        """The speed of the contact point along the normal, in m/s."""
        return (
            self.speed[0] * contact.normal[0] + self.speed[1] * contact.normal[1] + self.spin * contact.lever
        )

    def step(
        self, pushes: list[tuple[Contact, float]], seconds: float, *, downhill: float = 0.0, mud: float = 1.0
    ) -> None:
        """Advances time with pushes in newtons, by Newton's second law and friction.

        `downhill` is the force of a slope towards the east, in newtons; `mud` multiplies the friction.
        """
        impulse = seconds / MASS
        north = self.speed[0] + impulse * sum(contact.normal[0] * force for contact, force in pushes)
        east = self.speed[1] + impulse * (downhill + sum(c.normal[1] * force for c, force in pushes))
        spin = self.spin + impulse / GYRATION**2 * sum(contact.lever * force for contact, force in pushes)
        motion = math.hypot(north, east, GYRATION * spin)
        factor = max(0.0, 1.0 - impulse * FRICTION * mud / motion) if motion > 0.0 else 0.0
        self.speed, self.spin = (north * factor, east * factor), spin * factor
        self.north += self.speed[0] * seconds
        self.east += self.speed[1] * seconds
        self.heading = math.remainder(self.heading + self.spin * seconds, math.tau)


def _clamp(value: float, limit: float) -> float:
    return min(limit, max(-limit, value))
