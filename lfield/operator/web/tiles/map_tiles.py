"""Tiles of a map as pictures of 256 pixels, and their sources: a file, or a server on a network.

Columns are counted from the west and rows from the north, as browsers do (Web Mercator, XYZ).
"""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct

#: First bytes of the supported pictures, and their media types.
_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}
#: Largest zoom: at 24 a pixel is 9 mm.
MAX_ZOOM = 24
#: The address of the page's own server.
OWN_ADDRESS = "tiles/{z}/{x}/{y}"


class MapTile(Struct, frozen=True):
    """A picture and its media type.

    The type follows from the first bytes: no other part of a file is sent to browsers.
    """

    data: bytes
    kind: str


class MapBackground(Protocol):
    """A source of tiles: a file on this computer, or an address that browsers request themselves."""

    #: The address where browsers request tiles, with {z}, {x} and {y}.
    address: str
    #: The server of another address than that of the page, '' for the page's own.
    origin: str
    #: The zooms that have tiles; browsers enlarge those of the last one.
    min_zoom: int
    max_zoom: int
    #: The attribution of the author.
    credit: str

    def tile(self, zoom: int, column: int, row: int) -> MapTile | None:
        """A tile of a file, its row counted from the north; None where there is none."""

    def close(self) -> None:
        """Close the file."""


def tile_of(data: object) -> MapTile | None:
    """The tile of some bytes; None if they are no supported picture."""
    if not isinstance(data, bytes):
        return None
    kind = next((kind for start, kind in _KINDS.items() if data.startswith(start)), None)
    return None if kind is None else MapTile(data, kind)


def is_in_grid(zoom: int, column: int, row: int) -> bool:
    """Whether a zoom has such a tile."""
    return 0 <= zoom <= MAX_ZOOM and 0 <= column < 1 << zoom and 0 <= row < 1 << zoom
