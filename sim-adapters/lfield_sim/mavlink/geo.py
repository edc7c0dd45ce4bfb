"""Positions and attitudes in MAVLink: the local frame on the Earth, frames, quaternions."""

from __future__ import annotations

import math

from msgspec import Struct
from msgspec.structs import replace

from lfield_sim.autopilot.body.goals import Vector

EARTH_RADIUS = 6378137.0
#: Radius of PX4's sphere, as recorded (px4-copter.e-gcs-loss); ArduPilot's is within 40 m of ours.
PX4_RADIUS = 6371000.0
#: The square of the first eccentricity of the ellipsoid (WGS 84).
ECCENTRICITY = 6.69437999014e-3
#: MAV_FRAMEs whose height is above home; the other global ones are above mean sea level.
ABOVE_HOME = frozenset({3, 6, 10, 11})
#: Maximum distance of a goal from the origin in metres.
FARTHEST = 1e6


class GeoOrigin(Struct, frozen=True):
    """The origin of the local frame: degrees, and metres above mean sea level. Flat around it.

    `radii` are the radii of curvature along the meridian and across it, in metres.
    """

    latitude: float = 47.3977420
    longitude: float = 8.5455940
    altitude: float = 488.0
    radii: tuple[float, float] = (EARTH_RADIUS, EARTH_RADIUS)

    @property
    def on_ellipsoid(self) -> GeoOrigin:
        """The same on the ellipsoid."""
        bulge = 1.0 - ECCENTRICITY * math.sin(math.radians(self.latitude)) ** 2
        across = EARTH_RADIUS / math.sqrt(bulge)
        return replace(self, radii=(across * (1.0 - ECCENTRICITY) / bulge, across))

    def at(self, north: float, east: float) -> tuple[int, int]:
        """Latitude and longitude of a position near the origin, in 1e-7 degrees."""
        latitude = self.latitude + math.degrees(north / self.radii[0])
        longitude = self.longitude + math.degrees(east / (self.radii[1] * self._shrink))
        return round(latitude * 1e7), round(longitude * 1e7)

    def moved(self, north: float, east: float) -> GeoOrigin:
        """The position at an offset in metres."""
        latitude, longitude = self.at(north, east)
        return replace(self, latitude=latitude / 1e7, longitude=longitude / 1e7)

    def local(self, latitude: float, longitude: float) -> tuple[float, float]:
        """Metres north and east of the origin, from 1e-7 degrees."""
        north = math.radians(latitude / 1e7 - self.latitude) * self.radii[0]
        east = math.radians(longitude / 1e7 - self.longitude) * self.radii[1] * self._shrink
        return north, east

    @property
    def _shrink(self) -> float:
        return math.cos(math.radians(self.latitude))


def is_near(vector: Vector) -> bool:
    """Whether a position can be flown to; NaN cannot."""
    return all(abs(part) < FARTHEST for part in vector)


def turned(vector: Vector, yaw: float) -> Vector:
    """Converts forward, right, down at heading `yaw` to north, east, down."""
    forward, right, down = vector
    cos, sin = math.cos(yaw), math.sin(yaw)
    return cos * forward - sin * right, sin * forward + cos * right, down


def quaternion(roll: float, pitch: float, yaw: float) -> list[float]:
    """w, x, y, z of a rotation by yaw, then pitch, then roll."""
    cr, cp, cy = (math.cos(angle / 2) for angle in (roll, pitch, yaw))
    sr, sp, sy = (math.sin(angle / 2) for angle in (roll, pitch, yaw))
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


def angles(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a unit quaternion."""
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw
