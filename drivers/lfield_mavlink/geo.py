"""Places on the Earth and metres between them.

Between two places near each other it is flat, and a sphere, as the autopilots reckon; a degree of longitude
is taken at the middle latitude. Over 5 km the error of that is below a metre. What several vehicles go by is
the ellipsoid, by geographiclib.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from geographiclib.geodesic import Geodesic

from lfield.driver import Origin, Vector

__all__ = ["EARTH_RADIUS", "Place", "Vector", "onto", "round_from"]

#: The Earth's equatorial radius in metres (WGS 84).
EARTH_RADIUS = 6378137.0


@dataclass(frozen=True, slots=True)
class Place:
    """Latitude and longitude in degrees, height above mean sea level in metres."""

    latitude: float
    longitude: float
    altitude: float

    @classmethod
    def scaled(cls, latitude: int, longitude: int, altitude: int) -> Place | None:
        """From 1e-7 degrees and millimetres as in messages; None when that is no place on Earth.

        Both angles 0 is what autopilots send before they know.
        """
        if abs(latitude) > 900_000_000 or abs(longitude) > 1_800_000_000 or not (latitude or longitude):
            return None
        return cls(latitude / 1e7, longitude / 1e7, altitude / 1000.0)

    def to(self, other: Place, radius: float = EARTH_RADIUS) -> Vector:
        """The way from here to there."""
        north = math.radians(other.latitude - self.latitude) * radius
        # The short way round, also across the date line.
        degrees = math.remainder(other.longitude - self.longitude, 360.0)
        east = math.radians(degrees) * radius * _shrink(self.latitude, other.latitude)
        return (north, east, self.altitude - other.altitude)

    def shifted(self, way: Vector, radius: float = EARTH_RADIUS) -> Place:
        """The place at the end of a way from here."""
        north, east, down = way
        latitude = self.latitude + math.degrees(north / radius)
        shrink = _shrink(self.latitude, latitude)
        longitude = self.longitude + math.degrees(east / (radius * shrink))
        return Place(latitude, math.remainder(longitude, 360.0), self.altitude - down)


def onto(origin: Origin | Place, place: Place) -> Vector:
    """Metres north and east of an origin, along the geodesic from there; and the turn of north, in radians.

    That is how north at `place` is turned against the origin's, clockwise.
    """
    found = Geodesic.WGS84.Inverse(origin.latitude, origin.longitude, place.latitude, place.longitude)
    there, far = math.radians(found["azi1"]), found["s12"]
    turn = math.remainder(there - math.radians(found["azi2"]), math.tau)
    return (far * math.cos(there), far * math.sin(there), turn)


def round_from(origin: Origin | Place, north: float, east: float) -> tuple[float, float]:
    """Latitude and longitude of a place so many metres north and east of an origin: the inverse of `onto`."""
    bearing = math.degrees(math.atan2(east, north))
    far = math.hypot(north, east)
    found = Geodesic.WGS84.Direct(origin.latitude, origin.longitude, bearing, far)
    return (found["lat2"], found["lon2"])


def _shrink(a: float, b: float) -> float:
    """How much shorter a degree of longitude is than at the equator; never 0, not even at a pole."""
    return max(math.cos(math.radians((a + b) / 2.0)), 1e-6)
