"""Mission files of ground stations, as a driver reports them to commands and to the compiler.

The format of the files and their rules are the driver's (`Plugin.plans`); positions are in degrees.
"""

from __future__ import annotations

import codecs
from collections.abc import Mapping, Sequence

from msgspec import Struct, field

from lfield.errors import MissionFileError
from lfield.geodata.findings import FileFinding

_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)

#: Latitude and longitude in degrees.
Position = tuple[float, float]


class PlanRequest(Struct, frozen=True):
    """The vehicle that a plan is checked for.

    `kind` is the kind of vehicle and `firmware` the autopilot's software, '' for any. `limits` are those of a
    binding: `altitude` and `radius` in metres, `speed` in m/s. `home` is latitude, longitude and metres above
    mean sea level, instead of the home that the file plans. `options` are those of a binding, from which the
    driver takes kind and firmware if they are ''.
    """

    kind: str = ""
    firmware: str = ""
    limits: Mapping[str, float] = field(default_factory=dict)
    home: tuple[float, float, float] | None = None
    options: Mapping[str, object] = field(default_factory=dict)


class PlanZone(Struct, frozen=True):
    """A zone of a fence: a polygon, or a circle around its only corner with a `radius` in metres."""

    inclusion: bool
    corners: tuple[Position, ...]
    radius: float = 0.0


class PlanPoint(Struct, frozen=True):
    """A position that an item leads to. `height` is in metres above home, None if unknown."""

    item: int
    position: Position
    height: float | None
    meaning: str = ""


class PlanReport(Struct, frozen=True):
    """The contents of a mission file, and its defects for the vehicle of the request.

    `kind` and `firmware` are those that the file was made for, '' if unknown. `items` counts the
    items of the mission. `length` is in metres, `extent` in square metres (of an area), `duration` in
    seconds. `highest` and `farthest` are metres above and from home, each with the number of its item; None
    if unknown.
    """

    findings: Sequence[FileFinding] = ()
    kind: str = ""
    firmware: str = ""
    items: int = 0
    length: float = 0.0
    extent: float = 0.0
    duration: float = 0.0
    highest: tuple[float, int] | None = None
    farthest: tuple[float, int] | None = None
    home: Position | None = None
    path: Sequence[PlanPoint] = ()
    zones: Sequence[PlanZone] = ()
    rally: Sequence[Position] = ()
    areas: Sequence[Sequence[Position]] = ()

    @property
    def is_usable(self) -> bool:
        """Whether no finding is an error."""
        return not any(finding.is_error for finding in self.findings)


def ascii_number(text: str) -> float:
    """A number in ASCII; `float` alone also accepts `1_6` and digits of other scripts. Raises ValueError."""
    if not text.isascii() or "_" in text:
        raise ValueError(f"'{text[:40]}' is not a number")
    return float(text)


def utf8_bytes(file: str, data: bytes) -> bytes:
    """The bytes without a byte order mark. Raises MissionFileError for another encoding than UTF-8."""
    if data.startswith(_WIDE):
        raise MissionFileError(file, "it is not UTF-8 but UTF-16 or UTF-32; save it as UTF-8")
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        reason = f"byte {error.start} (0x{data[error.start]:02X}) is not UTF-8; save it as UTF-8"
        raise MissionFileError(file, reason) from None
    return data
