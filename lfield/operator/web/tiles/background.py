"""The background of the map: a file of tiles, or the address of a tile server, by what the operator named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from lfield.errors import InputFileError
from lfield.geodata.map_drawings import MapDrawing
from lfield.operator.web.tiles.map_tiles import MapBackground
from lfield.operator.web.tiles.mbtiles import MbtilesSource
from lfield.operator.web.tiles.pmtiles_file import PmtilesSource, is_pmtiles
from lfield.operator.web.tiles.tile_address import TileAddress, is_address


class PageBackground(NamedTuple):
    """What the map shows below vehicles: tiles, and drawings of files."""

    tiles: MapBackground | None = None
    drawings: Sequence[MapDrawing] = ()


NO_BACKGROUND = PageBackground()


def open_background(name: str) -> MapBackground:
    """The background of an MBTiles or PMTiles file, or of an address. Raises InputFileError, UsageError."""
    if is_address(name):
        return TileAddress(name)
    path = Path(name)
    if not path.is_file():
        why = "not a file" if path.exists() else "there is no such file"
        raise InputFileError(name, f"{why}; expected an MBTiles or PMTiles file, or an https address")
    return PmtilesSource(path) if is_pmtiles(path) else MbtilesSource(path)
