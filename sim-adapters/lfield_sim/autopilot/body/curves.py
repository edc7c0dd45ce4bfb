"""Curves of ArduPilot's missions as points: spline and arc.

Spline: AC_WPNav::set_spline_destination_loc and SplineCurve of ArduPilot, a cubic Hermite curve whose
tangents depend on the neighbours of its ends. Arc: MAV_CMD_NAV_ARC_WAYPOINT. Metres north, east and down;
pure geometry.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from lfield_sim.autopilot.body.goals import Vector

#: Points of a spline; radians between two points of an arc.
POINTS, STEP = 40, math.radians(5.0)
#: Maximum sum of the two tangents of a spline, relative to the straight distance.
LONGEST = 4.0


def spline(
    before: Vector | None, start: Vector, goal: Vector, after: Vector | None, *, straight_on: bool = False
) -> Sequence[Vector]:
    """The points from `start` to `goal`, without the first; `before` and `after` are the neighbours.

    A spline that starts or ends at rest has no neighbour there. `straight_on`: the next leg is straight.
    """
    straight = _minus(goal, start)
    start_tangent = straight if before is None else _minus(start, before)
    end_tangent = straight if after is None else _minus(after, goal if straight_on else start)
    tangent_sum = math.hypot(*(b + e for b, e in zip(start_tangent, end_tangent, strict=True)))
    longest = LONGEST * math.hypot(*straight)
    share = longest / tangent_sum if tangent_sum > longest else 1.0
    return [
        _hermite(start, goal, start_tangent, end_tangent, share, number / POINTS)
        for number in range(1, POINTS + 1)
    ]


def _hermite(
    start: Vector, goal: Vector, start_tangent: Vector, end_tangent: Vector, share: float, t: float
) -> Vector:
    square, cube = t * t, t * t * t
    weights = (
        2.0 * cube - 3.0 * square + 1.0,
        3.0 * square - 2.0 * cube,
        share * (cube - 2.0 * square + t),
        share * (cube - square),
    )
    parts = zip(start, goal, start_tangent, end_tangent, strict=True)
    north, east, down = (sum(w * p for w, p in zip(weights, each, strict=True)) for each in parts)
    return (north, east, down)


def arc(start: Vector, goal: Vector, degrees: float) -> Sequence[Vector]:
    """The points of an arc to `goal`, without the first; clockwise for positive degrees."""
    north, east, down = _minus(goal, start)
    chord, half = math.hypot(north, east), math.radians(degrees) / 2.0
    if chord < 1e-3 or not 1e-4 < abs(half) < math.pi:
        return [goal]
    offset = chord / 2.0 / math.tan(half)
    centre = (
        (start[0] + goal[0]) / 2.0 - east / chord * offset,
        (start[1] + goal[1]) / 2.0 + north / chord * offset,
    )
    radius, count = (start[0] - centre[0], start[1] - centre[1]), max(2, math.ceil(abs(2.0 * half) / STEP))
    points: list[Vector] = []
    for number in range(1, count + 1):
        turn, share = 2.0 * half * number / count, number / count
        cos, sin = math.cos(turn), math.sin(turn)
        points.append(
            (
                centre[0] + radius[0] * cos - radius[1] * sin,
                centre[1] + radius[0] * sin + radius[1] * cos,
                start[2] + share * down,
            )
        )
    return points


def _minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])
