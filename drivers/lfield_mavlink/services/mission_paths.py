"""Bounds of curved mission paths: splines and arcs. Pure geometry.

All limits of a binding bound a convex region (a circle around home, a ceiling), so a path is inside if the
corners of a polygon around it are. Vectors are metres north, east and down of home.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from lfield_mavlink.geodesy import Vector

#: Radians between two points of an arc.
STEP = math.radians(5.0)
#: Degrees below which an arc is a straight line.
STRAIGHT = 0.01


def spline_corners(
    before: Vector | None, start: Vector, goal: Vector, after: Vector | None
) -> Iterator[Vector]:
    """Corners of a polygon that contains the spline from `start` to `goal`.

    `before` and `after` are their neighbours or None. ArduPilot's tangent at a position is the vector from
    its predecessor to its successor, or between one of them and the position, possibly shortened; a cubic
    stays inside the polygon of its ends and of the ends plus a third of the tangents.
    """
    yield start
    yield goal
    for end in (goal, start) if before is not None else ():
        assert before is not None
        yield _plus(start, _minus(end, before), 1.0 / 3.0)
    for end in (start, goal) if after is not None else ():
        assert after is not None
        yield _plus(goal, _minus(after, end), -1.0 / 3.0)


def arc_corners(start: Vector, goal: Vector, degrees: float) -> Sequence[Vector] | None:
    """Corners of a polygon that contains the arc from `start` to `goal`; None if there is no such arc.

    `degrees` is the angle of the arc, positive clockwise (MAV_CMD_NAV_ARC_WAYPOINT).
    """
    if not abs(degrees) < 360.0:  # refuses NaN as well
        return None
    north, east, _ = _minus(goal, start)
    chord = math.hypot(north, east)
    if abs(degrees) < STRAIGHT or chord == 0.0:
        return (start, goal)
    half = math.radians(degrees) / 2.0
    radius = chord / (2.0 * math.sin(abs(half)))
    # To the right of the chord for a clockwise arc of less than half a turn.
    sideways = math.copysign(radius, half) * math.cos(half)
    centre = (
        (start[0] + goal[0]) / 2.0 - east / chord * sideways,
        (start[1] + goal[1]) / 2.0 + north / chord * sideways,
    )
    count = max(2, math.ceil(abs(2.0 * half) / STEP))
    # Outside the circle, so that the chords between the corners do not intersect it.
    scale = 1.0 / math.cos(abs(half) / count)
    out = (start[0] - centre[0], start[1] - centre[1])
    corners = [start, goal]
    for number in range(count + 1):
        turn = 2.0 * half * number / count
        cos, sin = scale * math.cos(turn), scale * math.sin(turn)
        corners.append(
            (
                centre[0] + out[0] * cos - out[1] * sin,
                centre[1] + out[0] * sin + out[1] * cos,
                min(start[2], goal[2]),
            )
        )
    return corners


def _minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _plus(a: Vector, vector: Vector, share: float) -> Vector:
    return (a[0] + share * vector[0], a[1] + share * vector[1], a[2] + share * vector[2])
