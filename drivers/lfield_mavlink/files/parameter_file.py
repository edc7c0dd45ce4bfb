"""Reads parameter files of ground stations.

`.param` and `.parm` of Mission Planner and MAVProxy: `NAME,VALUE` or `NAME VALUE`, with comments after `#`,
and `@READONLY` as in ArduPilot's default parameters. `.params` of QGroundControl: system, component, name,
value and type, separated by tabs, after a header with firmware and vehicle.
https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/parameters.html
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from msgspec import Struct, field

from lfield.driver import MissionFileError, ascii_number, utf8_bytes
from lfield_mavlink.link.dialect import AUTOPILOT
from lfield_mavlink.services.parameter_values import NAME_LENGTH

_NAME = re.compile(rf"[A-Za-z][A-Za-z0-9_]{{0,{NAME_LENGTH - 1}}}")
_HEXADECIMAL = re.compile("0[xX][0-9a-fA-F]+")
_SEPARATOR = re.compile(r"[\s,=]+")
_HEADER = re.compile(r"#\s*(Stack|Vehicle):\s*(.*)")
#: Parts of the names of vehicles in QGroundControl's header, by kind; the first that is found counts.
_KINDS: Sequence[tuple[str, str]] = (
    ("vtol", "plane"),
    ("fixed", "plane"),
    ("rotor", "copter"),
    ("copter", "copter"),
    ("rover", "rover"),
    ("boat", "rover"),
    ("sub", "submarine"),
)
#: Columns of QGroundControl: system, component, name, value, type.
_QGC_COLUMNS = 5
READ_ONLY = "@READONLY"
#: Lines with other files, which are not read.
_INCLUDE = "@include"


class ParameterFile(Struct):
    """The values of a file by name, in its order.

    `firmware` is `ardupilot`, `px4` or '', `kind` a kind of the driver or ''. `read_only` are the names that
    the file itself marks so, `others` the number of values of other components.
    """

    file: str
    values: dict[str, float] = field(default_factory=dict)
    firmware: str = ""
    kind: str = ""
    read_only: set[str] = field(default_factory=set)
    others: int = 0


def read_parameters(file: str, data: bytes) -> ParameterFile:
    """The content of a parameter file. Raises MissionFileError with the line."""
    content = ParameterFile(file)
    for number, line in enumerate(utf8_bytes(file, data).decode().splitlines(), 1):
        text, _, comment = line.partition("#")
        if not text.strip():
            _read_header(content, line)
            continue
        try:
            _read_line(content, [part for part in _SEPARATOR.split(text.strip()) if part])
        except ValueError as error:
            raise MissionFileError(file, str(error), where=f"line {number}") from None
        if READ_ONLY in comment:
            content.read_only.add(next(reversed(content.values)))
    if not content.values:
        raise MissionFileError(file, "it has no parameter")
    return content


def _read_header(content: ParameterFile, line: str) -> None:
    if (match := _HEADER.match(line.strip())) is None:
        return
    key, value = match[1], match[2].lower()
    if key == "Stack":
        firmwares: Mapping[str, str] = {"px4": "px4", "ardupilot": "ardupilot", "apm": "ardupilot"}
        content.firmware = next((name for part, name in firmwares.items() if part in value), "")
    else:
        content.kind = next((kind for part, kind in _KINDS if part in value), "")


def _read_line(content: ParameterFile, parts: Sequence[str]) -> None:
    """Raises ValueError."""
    if parts[0] == _INCLUDE:
        raise ValueError(
            f"it includes {' '.join(parts[1:])[:80]}, which is not read; name one file with all values"
        )
    if len(parts) == _QGC_COLUMNS and parts[0].isdecimal():
        if parts[1] != str(AUTOPILOT):
            content.others += 1
            return
        parts = parts[2:4]
    is_read_only = len(parts) == 3 and parts[2] == READ_ONLY
    if len(parts) != 2 and not is_read_only:
        raise ValueError(f"'{' '.join(parts)[:60]}' is not NAME,VALUE")
    name, text = parts[:2]
    if _NAME.fullmatch(name) is None:
        raise ValueError(f"'{name[:60]}' is not the name of a parameter")
    value = _number(text)
    if name in content.values and content.values[name] != value:
        raise ValueError(f"{name} is here {value:g} and was {content.values[name]:g} before")
    content.values[name] = value
    if is_read_only:
        content.read_only.add(name)


def _number(text: str) -> float:
    try:
        value = float(int(text, 16)) if _HEXADECIMAL.fullmatch(text) else ascii_number(text)
    except (ValueError, OverflowError):
        raise ValueError(f"'{text[:40]}' is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"'{text[:40]}' is not a finite number")
    return value
