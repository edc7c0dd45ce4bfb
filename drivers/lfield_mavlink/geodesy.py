"""Positions on the Earth and distances in metres.

Between near positions a flat approximation on a sphere, as in the autopilots, with a degree of longitude at
the middle latitude; its error is below a metre over 5 km. The team's frame uses the ellipsoid, by
geographiclib.
"""

from __future__ import annotations

import math

from geographiclib.geodesic import Geodesic
from msgspec import Struct

from lfield.driver import Origin, Vector

__all__ = ["EARTH_RADIUS", "Place", "Vector", "geodesic_offset", "geodesic_position"]

#: The Earth's equatorial radius in metres (WGS 84).
EARTH_RADIUS = 6378137.0


class Place(Struct, frozen=True):
    """Latitude and longitude in degrees, height above mean sea level in metres."""

    latitude: float
    longitude: float
    altitude: float

    @classmethod
    def scaled(cls, latitude: int, longitude: int, altitude: int) -> Place | None:
        """The place of 1e-7 degrees and millimetres as in messages; None for an invalid position.

        Autopilots send 0, 0 before they know their position.
        """
        if abs(latitude) > 900_000_000 or abs(longitude) > 1_800_000_000 or not (latitude or longitude):
            return None
        return cls(latitude / 1e7, longitude / 1e7, altitude / 1000.0)

    def vector_to(self, other: Place, radius: float = EARTH_RADIUS) -> Vector:
        """The vector to another position, in metres."""
        north = math.radians(other.latitude - self.latitude) * radius
        # The shortest difference, also across the date line.
        degrees = math.remainder(other.longitude - self.longitude, 360.0)
        east = math.radians(degrees) * radius * _shrink(self.latitude, other.latitude)
        return (north, east, self.altitude - other.altitude)

    def shifted(self, vector: Vector, radius: float = EARTH_RADIUS) -> Place:
        """The position at the end of a vector that starts at this one."""
        north, east, down = vector
        latitude = self.latitude + math.degrees(north / radius)
        shrink = _shrink(self.latitude, latitude)
        longitude = self.longitude + math.degrees(east / (radius * shrink))
        return Place(latitude, math.remainder(longitude, 360.0), self.altitude - down)


def geodesic_offset(origin: Origin | Place, place: Place) -> Vector:
    """Metres north and east of an origin along the geodesic, and the turn of north in radians.

    The turn is how far north at `place` is rotated clockwise against north at the origin.
    """
    inverse = Geodesic.WGS84.Inverse(origin.latitude, origin.longitude, place.latitude, place.longitude)
    azimuth, distance = math.radians(inverse["azi1"]), inverse["s12"]
    turn = math.remainder(azimuth - math.radians(inverse["azi2"]), math.tau)
    return (distance * math.cos(azimuth), distance * math.sin(azimuth), turn)


def geodesic_position(origin: Origin | Place, north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude of a position given in metres north and east of an origin: the inverse of
    `geodesic_offset`.
    """
    bearing = math.degrees(math.atan2(east, north))
    distance = math.hypot(north, east)
    direct = Geodesic.WGS84.Direct(origin.latitude, origin.longitude, bearing, distance)
    return (direct["lat2"], direct["lon2"])


def _shrink(a: float, b: float) -> float:
    """Length of a degree of longitude relative to the equator; never 0, even at a pole."""
    return max(math.cos(math.radians((a + b) / 2.0)), 1e-6)
