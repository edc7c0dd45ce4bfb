"""Where a thing is and how it lies, as MAVLink tells it: the local frame on Earth, frames, quaternions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from lfield_sim.autopilot.body.goals import Vector

EARTH_RADIUS = 6378137.0
#: Of the sphere on which PX4 counts, as recorded (px4-copter.e-gcs-loss); ArduPilot's is within 40 m of ours.
PX4_RADIUS = 6371000.0
#: The square of the first eccentricity of the ellipsoid (WGS 84).
ECCENTRICITY = 6.69437999014e-3
#: MAV_FRAMEs whose height is above home; the other global ones are above mean sea level.
ABOVE_HOME = frozenset({3, 6, 10, 11})
#: Farther from the origin than this (m) nothing is flown to.
FARTHEST = 1e6


@dataclass(frozen=True, slots=True)
class Place:
    """The origin of the local frame: degrees, and metres above mean sea level. Flat around it.

    `radii` are those of the Earth along the meridian and across it, as they are counted with here, in metres.
    """

    latitude: float = 47.3977420
    longitude: float = 8.5455940
    altitude: float = 488.0
    radii: tuple[float, float] = (EARTH_RADIUS, EARTH_RADIUS)

    @property
    def truly(self) -> Place:
        """The same on the ellipsoid, as a tape measures."""
        bulge = 1.0 - ECCENTRICITY * math.sin(math.radians(self.latitude)) ** 2
        across = EARTH_RADIUS / math.sqrt(bulge)
        return replace(self, radii=(across * (1.0 - ECCENTRICITY) / bulge, across))

    def at(self, north: float, east: float) -> tuple[int, int]:
        """Latitude and longitude of a place near the origin, in 1e-7 degrees."""
        latitude = self.latitude + math.degrees(north / self.radii[0])
        longitude = self.longitude + math.degrees(east / (self.radii[1] * self._shrink))
        return round(latitude * 1e7), round(longitude * 1e7)

    def moved(self, north: float, east: float) -> Place:
        """The place so many metres from this one."""
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
    """Whether a place is one that can be flown to; NaN is not."""
    return all(abs(part) < FARTHEST for part in vector)


def turned(vector: Vector, yaw: float) -> Vector:
    """Forward, right, down of a nose at `yaw` as north, east, down."""
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
