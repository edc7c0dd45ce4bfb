"""Places on the Earth and metres between them. Flat between two places: for fields, not for oceans.

A degree of longitude is taken at the middle latitude, as the autopilots do; over 5 km the error is below
a metre.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

#: The Earth's equatorial radius in metres (WGS 84).
EARTH_RADIUS = 6378137.0

Vector = tuple[float, float, float]
"""North, east, down in metres, or in m/s."""


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

    def to(self, other: Place) -> Vector:
        """The way from here to there."""
        north = math.radians(other.latitude - self.latitude) * EARTH_RADIUS
        # The short way round, also across the date line.
        degrees = math.remainder(other.longitude - self.longitude, 360.0)
        east = math.radians(degrees) * EARTH_RADIUS * _shrink(self.latitude, other.latitude)
        return (north, east, self.altitude - other.altitude)

    def shifted(self, way: Vector) -> Place:
        """The place at the end of a way from here."""
        north, east, down = way
        latitude = self.latitude + math.degrees(north / EARTH_RADIUS)
        shrink = _shrink(self.latitude, latitude)
        longitude = self.longitude + math.degrees(east / (EARTH_RADIUS * shrink))
        return Place(latitude, math.remainder(longitude, 360.0), self.altitude - down)


def _shrink(a: float, b: float) -> float:
    """How much shorter a degree of longitude is than at the equator; never 0, not even at a pole."""
    return max(math.cos(math.radians((a + b) / 2.0)), 1e-6)
