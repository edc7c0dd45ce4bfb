"""Where a vehicle may be: the fences that are parameters, and what was uploaded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from lfield_sim.vehicle import Vector

if TYPE_CHECKING:
    from lfield_sim.autopilot import Autopilot

#: FENCE_BREACH.
NONE, CEILING, BOUNDARY = 0, 2, 3


class Fence(Protocol):
    """Where a vehicle may be, as far as it was uploaded."""

    def breached(self, place: Vector) -> int:
        """A FENCE_BREACH type, 0 for none, of a place in the local frame."""


class NoFence:
    """No fence was uploaded."""

    def breached(self, place: Vector) -> int:
        """Never."""
        return NONE


def fence_at(pilot: Autopilot, place: Vector) -> tuple[int, str]:
    """Which fence a place is beyond (FENCE_BREACH), with what is said about it; (0, '') for none."""
    rule = pilot.flavour.fence
    if not pilot.value(rule.enable):
        return NONE, ""
    radius = pilot.value(rule.radius)
    if radius > 0 and math.dist(place[:2], pilot.home[:2]) > radius:
        return BOUNDARY, rule.circle_text
    ceiling = pilot.value(rule.ceiling) if rule.ceiling else 0.0
    if ceiling > 0 and pilot.home[2] - place[2] > ceiling:
        return CEILING, rule.ceiling_text
    shape = pilot.fence.breached(place)
    return (shape, rule.shape_text) if shape else (NONE, "")
