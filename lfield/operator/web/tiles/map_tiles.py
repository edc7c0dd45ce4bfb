"""Tiles of a map as pictures, and what has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

#: First bytes of the supported pictures, and their media types.
_KINDS = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp"}
#: Largest zoom: at 24 a pixel is 9 mm.
MAX_ZOOM = 24
#: The address of the page's own server.
OWN_ADDRESS = "tiles/{z}/{x}/{y}"


@dataclass(frozen=True, slots=True)
class MapTile:
    """A picture and its media type."""

    data: bytes
    kind: str


class MapBackground(Protocol):
    """A source of tiles: `address` with {z}, {x}, {y} is where browsers request them, `origin` the server of
    another address, '' for the page's own. `credit` is the attribution of the author."""

    address: str
    origin: str
    min_zoom: int
    max_zoom: int
    credit: str

    def tile(self, zoom: int, column: int, row: int) -> MapTile | None:
        """A tile of a file, its row counted from the north; None where there is none."""

    def close(self) -> None:
        """Close the file."""


def picture(data: object) -> MapTile | None:
    """The tile of some bytes; None if they are no supported picture."""
    if not isinstance(data, bytes):
        return None
    kind = next((kind for start, kind in _KINDS.items() if data.startswith(start)), None)
    return None if kind is None else MapTile(data, kind)


def is_in_grid(zoom: int, column: int, row: int) -> bool:
    """Whether a zoom has such a tile."""
    return 0 <= zoom <= MAX_ZOOM and 0 <= column < 1 << zoom and 0 <= row < 1 << zoom
