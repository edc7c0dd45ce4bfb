"""Pose of a vehicle's frames in the team's frame: from its origin on the Earth, or from its binding.

The frame of an autopilot starts at the origin of its estimator, which is its first known position and fixed
until a restart; this driver uses home, which moves to where the vehicle is armed. A pose is that of the
origin; with a team origin on the Earth, the autopilot's reported origin is used. Each stack converts degrees
to metres on its own sphere; the team's frame uses the ellipsoid (WGS 84), by geographiclib. North and east
are along the geodesic from the team's origin, with exact distance and bearing; down is the difference in
height, not that of the tangent plane.
"""

from __future__ import annotations

import math
from functools import lru_cache

from msgspec import Struct

from lfield.driver import Frame, Origin, Placement, Vector
from lfield_mavlink.contact.vehicle_state import VehicleState
from lfield_mavlink.geodesy import Place, geodesic_offset, geodesic_position


class GeodeticFrame(Struct, frozen=True):
    """An autopilot's local frame at its `origin`, converted with a sphere of `radius` (m)."""

    team: Origin
    origin: Place
    radius: float

    @property
    def heading(self) -> float:
        """Meridian convergence: the difference of its north from the team's, below 1e-3 rad within 5 km."""
        return _rotation(self.team, self.origin)

    def to_team(self, place: Vector) -> Vector:
        """Metres from the origin of the vehicle to metres from the origin of the team."""
        position = self.origin.shifted(place, self.radius)
        north, east, _ = geodesic_offset(self.team, position)
        return (north, east, self.team.altitude - position.altitude)

    def from_team(self, place: Vector) -> Vector:
        """The inverse of `to_team`; NaN stays NaN."""
        if not all(map(math.isfinite, place)):
            return place
        latitude, longitude = geodesic_position(self.team, place[0], place[1])
        return self.origin.vector_to(Place(latitude, longitude, self.team.altitude - place[2]), self.radius)


@lru_cache(maxsize=64)
def _rotation(team: Origin, origin: Place) -> float:
    """The turn of the frames; cached, since both places are fixed and every telemetry value needs it."""
    return geodesic_offset(team, origin)[2]


class HomeFrame(Struct, frozen=True):
    """The frame of home, at an offset from the origin of the frame `local`."""

    local: Frame
    home: Vector

    @property
    def heading(self) -> float:
        """The heading of the local frame."""
        return self.local.heading

    def to_team(self, place: Vector) -> Vector:
        """Metres from home to metres from the team's origin."""
        north, east, down = (p + h for p, h in zip(place, self.home, strict=True))
        return self.local.to_team((north, east, down))

    def from_team(self, place: Vector) -> Vector:
        """The inverse of `to_team`."""
        north, east, down = (p - h for p, h in zip(self.local.from_team(place), self.home, strict=True))
        return (north, east, down)


def frame_of(placement: Placement, state: VehicleState) -> HomeFrame | None:
    """The frame of home in the team's frame, None while the vehicle's origin is unknown.

    A pose in its binding needs no origin, except after a restart of the autopilot: then its frame has a new
    origin, and the pose moves with it once it is known.
    """
    local: Frame | None = placement.pose
    moved = state.origin_moved
    if placement.pose is not None and moved is None:
        return None
    if local is None and placement.origin is not None and state.origin is not None:
        local, moved = GeodeticFrame(placement.origin, state.origin, state.radius), (0.0, 0.0, 0.0)
    if local is None:
        return None
    assert moved is not None, "checked above"
    north, east, down = (h + m for h, m in zip(state.home_offset, moved, strict=True))
    return HomeFrame(local, (north, east, down))
