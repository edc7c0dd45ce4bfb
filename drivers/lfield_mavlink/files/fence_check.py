"""Checks a plan against the fence in its own file. Pure.

ArduPilot keeps a vehicle inside every inclusion zone (FENCE_OPTIONS without bit 1), PX4 inside one of them.
For an unknown firmware every zone counts. Legs are treated as straight, also splines and arcs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from lfield.driver import (
    FileFinding,
    PlanZone,
    crosses,
    crossing_edges,
    distance_to_way,
    is_inside,
)
from lfield_mavlink.files.plan_path import PlanLeg, PlanPath
from lfield_mavlink.services.plan_items import MAX_CORNERS

_Point = tuple[float, float]


class _Zone:
    """A zone on the plane of a plan."""

    def __init__(self, number: int, zone: PlanZone, path: PlanPath) -> None:
        self.number, self.inclusion, self._radius = number, zone.inclusion, zone.radius
        self._corners = path.plane.points(zone.corners)

    @property
    def name(self) -> str:
        return f"{'inclusion' if self.inclusion else 'exclusion'} zone {self.number} of the fence"

    def mistake(self) -> str:
        """The reason why the zone is invalid; '' for a valid zone."""
        if len(self._corners) == 1:
            return "" if 0.0 < self._radius < math.inf else f"a circle with the radius {self._radius:g} m"
        if not 3 <= len(self._corners) <= MAX_CORNERS:
            return f"a polygon with {len(self._corners)} corners; 3 to {MAX_CORNERS} are permitted"
        if (crossing := crossing_edges(self._corners)) is not None:
            first, second = (edge + 1 for edge in crossing)
            return f"a polygon that crosses itself after its corners {first} and {second}"
        return ""

    def permits(self, point: _Point) -> bool:
        """Whether a point is on the permitted side."""
        if len(self._corners) == 1:
            inside = math.dist(self._corners[0], point) <= self._radius
        else:
            inside = is_inside(self._corners, point)
        return inside == self.inclusion

    def is_left(self, start: _Point, end: _Point) -> bool:
        """Whether the straight line between two permitted points leads to the other side."""
        if len(self._corners) == 1:
            return not self.inclusion and distance_to_way(self._corners[0], start, end) < self._radius
        return crosses(self._corners, start, end)


class FenceCheck:
    """Checks positions and legs; invalid zones are reported and not used."""

    def __init__(self, zones: Sequence[PlanZone], path: PlanPath, firmware: str) -> None:
        self._path, self._needs_one_zone = path, firmware == "px4"
        all_zones = [_Zone(number, zone, path) for number, zone in enumerate(zones, 1)]
        self._mistakes = [(zone.name, zone.mistake()) for zone in all_zones]
        self._zones = [zone for zone in all_zones if not zone.mistake()]
        self._inclusions = [zone for zone in self._zones if zone.inclusion]
        self._exclusions = [zone for zone in self._zones if not zone.inclusion]

    def zone_findings(self) -> Iterator[FileFinding]:
        """Invalid zones."""
        for name, mistake in self._mistakes:
            if mistake:
                yield FileFinding("M110", f"{name} is {mistake}")

    def path_findings(self) -> Iterator[FileFinding]:
        """Items and legs beyond the fence; a leg only if its ends are within it."""
        if not self._zones:
            return
        home = self._path.home
        for point in [*([home] if home is not None else []), *self._path.points]:
            if violation := self.position_violation(point.position):
                name = f"item {point.item}" if point.item else "home"
                yield FileFinding("M106", f"{name} is {violation}", point.item)
        for leg in self._path.legs:
            if violation := self._leg_violation(leg):
                start = f"item {leg.start.item}" if leg.start.item else "home"
                yield FileFinding(
                    "M106", f"the leg from {start} to item {leg.end.item} {violation}", leg.end.item
                )

    def position_violation(self, position: tuple[float, float]) -> str:
        """`outside inclusion zone 1 of the fence`; '' for a permitted position."""
        point = self._path.plane.point(position)
        for zone in self._exclusions:
            if not zone.permits(point):
                return f"inside {zone.name}"
        outside = [zone for zone in self._inclusions if not zone.permits(point)]
        if not outside or (self._needs_one_zone and len(outside) < len(self._inclusions)):
            return ""
        return f"outside {outside[0].name}"

    def _leg_violation(self, leg: PlanLeg) -> str:
        if self.position_violation(leg.start.position) or self.position_violation(leg.end.position):
            return ""
        start, end = self._path.plane.points([leg.start.position, leg.end.position])
        for zone in self._exclusions:
            if zone.is_left(start, end):
                return f"crosses {zone.name}"
        are_left = [
            not (zone.permits(start) and zone.permits(end)) or zone.is_left(start, end)
            for zone in self._inclusions
        ]
        if not any(are_left) or (self._needs_one_zone and not all(are_left)):
            return ""
        return f"leaves {self._inclusions[are_left.index(True)].name}"
