"""Where a vehicle's frames lie in the team's: by its autopilot's place on the Earth, or as its binding says.

An autopilot reckons from the origin of its estimator, which is where it first knew its place and stays there
until it restarts; this driver reckons from home, which moves to where the vehicle is armed. So a pose is that
of the origin, and a team whose frame begins at a place on the Earth goes by the origin that the autopilot
tells. On the way between degrees and metres each stack counts with a sphere of its own; what counts in the
team's frame is the ellipsoid (WGS 84), by geographiclib. North and east are along the geodesic from the
team's origin, exact in distance and bearing there; down is the difference in height, not the tangent plane's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from lfield.driver import Frame, Origin, Placement, Vector
from lfield_mavlink.contact.state import VehicleState
from lfield_mavlink.geo import Place, onto, round_from


@dataclass(frozen=True, slots=True)
class Earthly:
    """An autopilot's local frame at its `origin`, of which a degree has the length of a `radius` (m)."""

    team: Origin
    origin: Place
    radius: float

    @property
    def heading(self) -> float:
        """Meridians are not parallel: how its north differs from the team's, less than 1e-3 over 5 km."""
        return _turn(self.team, self.origin)

    def to_team(self, place: Vector) -> Vector:
        """Metres of its origin as metres of the team's."""
        there = self.origin.shifted(place, self.radius)
        north, east, _ = onto(self.team, there)
        return (north, east, self.team.altitude - there.altitude)

    def from_team(self, place: Vector) -> Vector:
        """And back; what is no place stays none."""
        if not all(map(math.isfinite, place)):
            return place
        latitude, longitude = round_from(self.team, place[0], place[1])
        return self.origin.to(Place(latitude, longitude, self.team.altitude - place[2]), self.radius)


@lru_cache(maxsize=64)
def _turn(team: Origin, origin: Place) -> float:
    """Whatever a vehicle tells is turned by it, many times a second, and neither of the two moves."""
    return onto(team, origin)[2]


@dataclass(frozen=True, slots=True)
class AboutHome:
    """The frame of home, which is so far from the origin of the frame `local`."""

    local: Frame
    home: Vector

    @property
    def heading(self) -> float:
        """Home has none of its own."""
        return self.local.heading

    def to_team(self, place: Vector) -> Vector:
        """Metres of home as metres of the team's origin."""
        north, east, down = (p + h for p, h in zip(place, self.home, strict=True))
        return self.local.to_team((north, east, down))

    def from_team(self, place: Vector) -> Vector:
        """And back."""
        north, east, down = (p - h for p, h in zip(self.local.from_team(place), self.home, strict=True))
        return (north, east, down)


def frame_of(placement: Placement, state: VehicleState) -> AboutHome | None:
    """The frame of home in the team's, None as long as the vehicle has not told where its origin is.

    A pose that its binding gives needs no telling, but after a restart of the autopilot: its frame begins
    anew then, and its pose moves with the origin, as far as that is told.
    """
    local: Frame | None = placement.pose
    moved = state.origin_moved
    if placement.pose is not None and moved is None:
        return None
    if local is None and placement.origin is not None and state.origin is not None:
        local, moved = Earthly(placement.origin, state.origin, state.radius), (0.0, 0.0, 0.0)
    if local is None:
        return None
    assert moved is not None, "looked at above"
    north, east, down = (h + m for h, m in zip(state.home_offset, moved, strict=True))
    return AboutHome(local, (north, east, down))
