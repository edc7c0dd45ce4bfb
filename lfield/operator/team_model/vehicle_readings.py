"""Positions of vehicles from telemetry: the meaning of quantities, conversion of metres to degrees. Sans-IO.

A device that knows its position in the team's frame reports it there (`lfield.driver.frame`); a geographic
position is converted to metres by the origin of the team, and vice versa. For a map a sphere with the
curvature of the ellipsoid at the origin is sufficient: within 100 km the error is below a part in a thousand.
Programs do not use these values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from msgspec import Struct

from lfield.driver.frame import Origin
from lfield.manifest import DeviceManifest, Quantity
from lfield.operator.team_model.team_state import GeoPosition, LocalPosition, TelemetryReading

#: The ellipsoid WGS 84: semi-major axis in metres, and the first eccentricity squared.
_AXIS, _ECCENTRICITY = 6378137.0, 0.00669437999014


#: The units of an array with a geographic position: each element has its own.
_GEO_UNITS = ("°, °", "°, °, m", "deg, deg", "deg, deg, m")


class Instruments(Struct, frozen=True):
    """The quantities of a device by meaning; '' for those that it does not have.

    `position` is north, east and perhaps down in metres, `geo_position` is latitude and longitude in degrees,
    perhaps metres above sea level; `heading` in radians, `battery` from 0 to 1. `home` is as `geo_position`,
    `fence` the radius of the fence around it in metres.
    """

    has_safe_state: bool | None = None
    position: str = "position"
    geo_position: str = "globalPosition"
    heading: str = "heading"
    speed: str = "groundSpeed"
    height: str = "altitude"
    battery: str = "battery"
    mode: str = "mode"
    armed: str = "armed"
    home: str = "home"
    fence: str = "fenceRadius"


#: For a device without a known manifest: the usual quantities of vehicles.
DEFAULT_INSTRUMENTS = Instruments()


def instruments_of(manifest: DeviceManifest) -> Instruments:
    """The quantities of a device type: by their usual names in vehicles, where type and unit match."""
    telemetry = {quantity.name: quantity for quantity in manifest.telemetry}
    arrays = [quantity for quantity in manifest.telemetry if quantity.type == "real[]"]
    local = [
        q.name
        for q in arrays
        if q.unit == "m" and (q.frame == "place" or q.name == DEFAULT_INSTRUMENTS.position)
    ]
    geo = [q.name for q in arrays if q.unit in _GEO_UNITS or q.name == DEFAULT_INSTRUMENTS.geo_position]
    return Instruments(
        has_safe_state=bool(manifest.safe_states),
        position=local[0] if local else "",
        geo_position=geo[0] if geo else "",
        heading=_named(telemetry, "real", "rad", DEFAULT_INSTRUMENTS.heading, "course"),
        speed=_named(telemetry, "real", "m/s", DEFAULT_INSTRUMENTS.speed, "speed"),
        height=_named(telemetry, "real", "m", DEFAULT_INSTRUMENTS.height),
        battery=_named(telemetry, "real", "", DEFAULT_INSTRUMENTS.battery),
        mode=_named(telemetry, "string", "", DEFAULT_INSTRUMENTS.mode),
        armed=_named(telemetry, "boolean", "", DEFAULT_INSTRUMENTS.armed),
        home=_named(telemetry, "real[]", "", DEFAULT_INSTRUMENTS.home),
        fence=_named(telemetry, "real", "m", DEFAULT_INSTRUMENTS.fence),
    )


def _named(quantities: Mapping[str, Quantity], type: str, unit: str, *names: str) -> str:
    fitting = (quantities[name] for name in names if name in quantities)
    return next((q.name for q in fitting if (q.type, q.unit) == (type, unit)), "")


# --- readings, which may be anything that a host has sent -----------------------------------------------


def to_number(reading: TelemetryReading | None) -> float | None:
    """A finite number, None for anything else."""
    value = reading.value if reading is not None else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def to_local_position(reading: TelemetryReading | None) -> LocalPosition | None:
    """North, east, and down if available."""
    found = _numbers(reading)
    return None if found is None else LocalPosition(found[0], found[1], found[2] if len(found) > 2 else None)


def to_geo_position(reading: TelemetryReading | None) -> GeoPosition | None:
    """Degrees, if plausible: a receiver without a fix may report anything."""
    found = _numbers(reading)
    if found is None or abs(found[0]) > 90.0 or abs(found[1]) > 180.0:
        return None
    return GeoPosition(found[0], found[1], found[2] if len(found) > 2 else None)


def _numbers(reading: TelemetryReading | None) -> Sequence[float] | None:
    """Two or three finite numbers, None for anything else."""
    value = reading.value if reading is not None else None
    if not isinstance(value, list) or len(value) not in (2, 3) or not all(map(math.isfinite, value)):
        return None
    return [float(each) for each in value]


# --- metres and degrees -------------------------------------------------------------------------------------


def local_to_geo(place: LocalPosition, origin: Origin) -> GeoPosition | None:
    """A position of the team's frame on the Earth; None beyond the poles."""
    north, east = _radii(origin)
    latitude = origin.latitude + math.degrees(place.north / north)
    longitude = origin.longitude + math.degrees(place.east / east) if east else origin.longitude
    if abs(latitude) > 90.0:
        return None
    altitude = None if place.down is None else origin.altitude - place.down
    return GeoPosition(latitude, math.remainder(longitude, 360.0), altitude)


def geo_to_local(place: GeoPosition, origin: Origin) -> LocalPosition:
    """A position on the Earth in the team's frame."""
    north, east = _radii(origin)
    longitude = math.remainder(place.longitude - origin.longitude, 360.0)
    down = None if place.altitude is None else origin.altitude - place.altitude
    return LocalPosition(
        math.radians(place.latitude - origin.latitude) * north, math.radians(longitude) * east, down
    )


def _radii(origin: Origin) -> tuple[float, float]:
    """Metres for a radian of latitude, and of longitude."""
    sine = math.sin(math.radians(origin.latitude))
    bent = 1.0 - _ECCENTRICITY * sine * sine
    meridian = _AXIS * (1.0 - _ECCENTRICITY) / bent**1.5
    return meridian, _AXIS / math.sqrt(bent) * math.cos(math.radians(origin.latitude))
