"""The background of the map: a file of tiles, or the address of a tile server, by what the operator named."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

from lfield.errors import InputFileError, UsageError
from lfield.geodata.map_drawings import MapDrawing
from lfield.operator.web.tiles.map_tiles import MapBackground
from lfield.operator.web.tiles.mbtiles import MbtilesSource
from lfield.operator.web.tiles.pmtiles_file import PmtilesSource, is_pmtiles

#: The largest zoom that common servers have; larger ones show its tiles enlarged.
SERVED_ZOOM = 19
#: Host names, IPv4 and IPv6 addresses with a port, as a content security policy may contain them.
_HOST = re.compile(r"([A-Za-z0-9.-]+|\[[0-9A-Fa-f:.]+\])(:[0-9]{1,5})?")
_FIELDS = re.compile(r"\{([^{}]*)\}")
_EXAMPLE = "as in https://tiles.example.org/{z}/{x}/{y}.png"


def is_address(name: str) -> bool:
    """Whether a name is an address, not a file."""
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]+://", name) is not None


class TileAddress:
    """A `MapBackground` whose tiles come from `origin`, the server of an address."""

    def __init__(self, address: str) -> None:
        """Raises UsageError for an address that is not one of a tile server."""
        try:
            parts = urlsplit(address)
            _ = parts.port  # raises for a port above 65535, which browsers ignore
        except ValueError as error:
            raise _address_error(address, str(error)) from None
        if parts.scheme not in ("http", "https"):
            raise _address_error(address, f"its scheme must be https or http, {_EXAMPLE}")
        if not _HOST.fullmatch(parts.netloc):
            raise _address_error(address, "it needs a host name, without user and password")
        fields = _FIELDS.findall(address)
        if sorted(fields) not in (["x", "y", "z"], ["-y", "x", "z"]) or _FIELDS.search(parts.netloc):
            raise _address_error(
                address, f"it needs {{z}}, {{x}} and {{y}} once each after the host, {_EXAMPLE}"
            )
        self.address, self.origin = address, f"{parts.scheme}://{parts.netloc}"
        self.min_zoom, self.max_zoom = 0, SERVED_ZOOM
        self.credit = f"map: {parts.netloc}"

    def tile(self, zoom: int, column: int, row: int) -> None:
        """None: browsers request the tiles of the server."""

    def close(self) -> None:
        """Has no effect: no file is open."""


def _address_error(address: str, reason: str) -> UsageError:
    return UsageError(f"--tiles {address[:200]}: {reason}")


class PageBackground(NamedTuple):
    """The background below vehicles: tiles, and drawings of files."""

    tiles: MapBackground | None = None
    drawings: Sequence[MapDrawing] = ()


NO_BACKGROUND = PageBackground()


def open_background(name: str) -> MapBackground:
    """The background of an MBTiles or PMTiles file, or of an address. Raises InputFileError, UsageError."""
    if is_address(name):
        return TileAddress(name)
    path = Path(name)
    if not path.is_file():
        problem = "not a file" if path.exists() else "there is no such file"
        raise InputFileError(name, f"{problem}; expected an MBTiles or PMTiles file, or an https address")
    return PmtilesSource(path) if is_pmtiles(path) else MbtilesSource(path)
