"""Where vehicles are by what their devices tell: which quantity means what, metres to degrees and back. Pure.

A device that knows its place in the team's frame tells it there (`lfield.driver.frame`); what a device tells
about the Earth becomes metres by the origin of the team, and the other way round. For a map that is good
enough on a sphere that has the curvature of the ellipsoid at the origin: within 100 km it is off by less than
a part in a thousand. No program is told these.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lfield.driver.frame import Origin
from lfield.manifest import DeviceManifest, Quantity
from lfield.operator.sight.seen import Earth, Local, Reading

#: The ellipsoid WGS 84: metres of its half axis, and its first eccentricity squared.
_AXIS, _ECCENTRICITY = 6378137.0, 0.00669437999014


#: The units of an array that is a place on the Earth: each element has its own.
_EARTHLY = ("°, °", "°, °, m", "deg, deg", "deg, deg, m")


@dataclass(frozen=True, slots=True)
class Instruments:
    """The quantities of a device by what an operator reads off them; '' for what it does not tell.

    `moves` is whether it has a safe state. `place` is north, east and perhaps down in metres, `earth` is
    latitude and longitude in degrees, perhaps metres above sea level; `heading` in radians, `battery` from 0
    to 1.
    """

    moves: bool | None = None
    place: str = "position"
    earth: str = "globalPosition"
    heading: str = "heading"
    speed: str = "groundSpeed"
    height: str = "altitude"
    battery: str = "battery"
    mode: str = "mode"
    armed: str = "armed"


#: What is thought of a device whose manifest nobody has: that it has what vehicles have.
USUAL = Instruments()


def instruments_of(manifest: DeviceManifest) -> Instruments:
    """The same of a device type: by the names that vehicles have for them, where type and unit fit too."""
    told = {quantity.name: quantity for quantity in manifest.telemetry}
    arrays = [quantity for quantity in manifest.telemetry if quantity.type == "real[]"]
    places = [q.name for q in arrays if q.unit == "m" and (q.frame == "place" or q.name == USUAL.place)]
    earths = [q.name for q in arrays if q.unit in _EARTHLY or q.name == USUAL.earth]
    return Instruments(
        moves=bool(manifest.safe_states),
        place=places[0] if places else "",
        earth=earths[0] if earths else "",
        heading=_named(told, "real", "rad", USUAL.heading, "course"),
        speed=_named(told, "real", "m/s", USUAL.speed, "speed"),
        height=_named(told, "real", "m", USUAL.height),
        battery=_named(told, "real", "", USUAL.battery),
        mode=_named(told, "string", "", USUAL.mode),
        armed=_named(told, "boolean", "", USUAL.armed),
    )


def _named(told: Mapping[str, Quantity], type: str, unit: str, *names: str) -> str:
    fitting = (told[name] for name in names if name in told)
    return next((q.name for q in fitting if (q.type, q.unit) == (type, unit)), "")


# --- values, which may be anything that a host has sent -----------------------------------------------------


def number(reading: Reading | None) -> float | None:
    """A finite number, None for anything else."""
    value = reading.value if reading is not None else None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def local(reading: Reading | None) -> Local | None:
    """North, east, and down where it is told."""
    found = _numbers(reading)
    return None if found is None else Local(found[0], found[1], found[2] if len(found) > 2 else None)


def earth(reading: Reading | None) -> Earth | None:
    """Degrees, where they are some: a receiver without a fix may tell anything."""
    found = _numbers(reading)
    if found is None or abs(found[0]) > 90.0 or abs(found[1]) > 180.0:
        return None
    return Earth(found[0], found[1], found[2] if len(found) > 2 else None)


def _numbers(reading: Reading | None) -> Sequence[float] | None:
    """Two or three finite numbers, None for anything else."""
    value = reading.value if reading is not None else None
    if not isinstance(value, list) or len(value) not in (2, 3) or not all(map(math.isfinite, value)):
        return None
    return [float(each) for each in value]


# --- metres and degrees -------------------------------------------------------------------------------------


def on_earth(place: Local, origin: Origin) -> Earth | None:
    """A place of the team's frame on the Earth; None beyond its poles."""
    north, east = _radii(origin)
    latitude = origin.latitude + math.degrees(place.north / north)
    longitude = origin.longitude + math.degrees(place.east / east) if east else origin.longitude
    if abs(latitude) > 90.0:
        return None
    altitude = None if place.down is None else origin.altitude - place.down
    return Earth(latitude, math.remainder(longitude, 360.0), altitude)


def in_frame(place: Earth, origin: Origin) -> Local:
    """A place on the Earth in the team's frame."""
    north, east = _radii(origin)
    way = math.remainder(place.longitude - origin.longitude, 360.0)
    down = None if place.altitude is None else origin.altitude - place.altitude
    return Local(math.radians(place.latitude - origin.latitude) * north, math.radians(way) * east, down)


def _radii(origin: Origin) -> tuple[float, float]:
    """Metres for a radian of latitude, and of longitude."""
    sine = math.sin(math.radians(origin.latitude))
    bent = 1.0 - _ECCENTRICITY * sine * sine
    meridian = _AXIS * (1.0 - _ECCENTRICITY) / bent**1.5
    return meridian, _AXIS / math.sqrt(bent) * math.cos(math.radians(origin.latitude))
