"""Parser of NMEA 0183 sentences of GNSS receivers: GGA, RMC and GSA. Pure.

`$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47`: talker, type, fields, and the XOR of all
characters between `$` and `*`. Empty fields are unknown values, which are omitted from the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime

Value = float | int | str | list[float]
Values = dict[str, Value]

#: Bytes: maximum length of a sentence. The standard allows 82; some receivers send more.
LONGEST = 120
#: m/s per knot.
KNOT = 1852.0 / 3600.0
#: The quality field of GGA.
FIXES = ("none", "gps", "dgps", "pps", "rtk", "float rtk", "estimated", "manual", "simulated")


class InvalidSentence(ValueError):
    """A damaged sentence, or a sentence with impossible values."""


def checksum(text: str) -> int:
    """The checksum of the text between `$` and `*`."""
    total = 0
    for character in text.encode("ascii"):
        total ^= character
    return total


def sentence(text: str) -> bytes:
    """A complete sentence for the text between `$` and `*`."""
    return f"${text}*{checksum(text):02X}\r\n".encode("ascii")


def parse(line: bytes) -> Values:
    """The telemetry of a sentence; empty for unknown types. Raises InvalidSentence."""
    try:
        text = line.strip().decode("ascii")
    except UnicodeDecodeError:
        raise InvalidSentence("bytes that are not text") from None
    body, star, received_sum = text[1:].rpartition("*")
    if not text.startswith("$") or not star or len(received_sum) != 2:
        raise InvalidSentence("no sentence")
    if received_sum.upper() != f"{checksum(body):02X}":
        raise InvalidSentence("a wrong checksum")
    name, *fields = body.split(",")
    reader = READERS.get(name[-3:]) if len(name) == 5 else None
    if reader is None:
        return {}
    try:
        return reader(fields)
    except (ValueError, IndexError, OverflowError):
        raise InvalidSentence(f"an invalid {name}") from None


def _gga(fields: Sequence[str]) -> Values:
    """Position, quality, satellites, height."""
    quality = int(fields[5])
    values: Values = {"fix": FIXES[quality] if 0 <= quality < len(FIXES) else f"quality {quality}"}
    if fields[6]:
        values["satellites"] = int(fields[6])
    if quality and fields[1] and fields[8]:
        values["position"] = [*_place(fields[1:5]), _number(fields[8])]
    return values


def _rmc(fields: Sequence[str]) -> Values:
    """Time and date, speed and course; without speed and course if the status is V, a warning."""
    values: Values = {}
    if fields[0] and fields[8]:
        when = datetime.strptime(fields[8] + fields[0][:6], "%d%m%y%H%M%S").replace(tzinfo=UTC)
        values["utc"] = when.strftime("%Y-%m-%dT%H:%M:%SZ")
    if fields[1] != "A":
        return values
    if fields[6]:
        values["speed"] = _number(fields[6]) * KNOT
    if fields[7]:
        values["course"] = math.radians(_number(fields[7]) % 360.0)
    return values


def _gsa(fields: Sequence[str]) -> Values:
    """The dilution of precision, if there is a fix."""
    return {"dilution": _number(fields[14])} if fields[1] in ("2", "3") and fields[14] else {}


def _place(fields: Sequence[str]) -> tuple[float, float]:
    """Latitude and longitude in degrees, from `4807.038,N,01131.000,E`."""
    latitude, longitude = _angle(fields[0], 2, 90.0), _angle(fields[2], 3, 180.0)
    signs = {"N": 1.0, "S": -1.0, "E": 1.0, "W": -1.0}
    if fields[1] not in ("N", "S") or fields[3] not in ("E", "W"):
        raise ValueError
    return latitude * signs[fields[1]], longitude * signs[fields[3]]


def _angle(text: str, digits: int, maximum: float) -> float:
    """Degrees from `dddmm.mmmm`."""
    minutes = _number(text[digits:])
    degrees = int(text[:digits]) + minutes / 60.0
    if not (0.0 <= minutes < 60.0 and 0.0 <= degrees <= maximum):
        raise ValueError
    return degrees


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


READERS: Mapping[str, Callable[[Sequence[str]], Values]] = {"GGA": _gga, "RMC": _rmc, "GSA": _gsa}
