"""Where the local frame is on Earth."""

from __future__ import annotations

import math
from dataclasses import dataclass

EARTH_RADIUS = 6378137.0


@dataclass(frozen=True, slots=True)
class Place:
    """The origin of the local frame: degrees, and metres above mean sea level. Flat around it."""

    latitude: float = 47.3977420
    longitude: float = 8.5455940
    altitude: float = 488.0

    def at(self, north: float, east: float) -> tuple[int, int]:
        """Latitude and longitude of a place near the origin, in 1e-7 degrees."""
        latitude = self.latitude + math.degrees(north / EARTH_RADIUS)
        longitude = self.longitude + math.degrees(east / (EARTH_RADIUS * self._shrink))
        return round(latitude * 1e7), round(longitude * 1e7)

    def local(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Metres north and east of the origin, from 1e-7 degrees."""
        north = math.radians(latitude / 1e7 - self.latitude) * EARTH_RADIUS
        east = math.radians(longitude / 1e7 - self.longitude) * EARTH_RADIUS * self._shrink
        return north, east

    @property
    def _shrink(self) -> float:
        return math.cos(math.radians(self.latitude))
