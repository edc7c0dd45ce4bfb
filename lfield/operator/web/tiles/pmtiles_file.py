"""Map background from a PMTiles file (version 3), read by the library of its authors."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from lfield.errors import InputFileError, PluginError
from lfield.operator.web.tiles.map_tiles import MAX_ZOOM, OWN_ADDRESS, MapTile, is_in_grid, tile_of

_MAGIC, _GZIP = b"PMTiles", b"\x1f\x8b"
#: The most bytes of a tile or decompressed directory: the lengths are those of the file.
_MOST_BYTES = 16 << 20


def is_pmtiles(path: Path) -> bool:
    """Whether a file begins as PMTiles do. Raises InputFileError."""
    try:
        with path.open("rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except OSError as error:
        raise InputFileError(str(path), str(error.strerror)) from None


class PmtilesSource:
    """A `MapBackground`: the tiles of one file."""

    def __init__(self, path: Path) -> None:
        """Raises InputFileError for a file without pictures, PluginError without the library."""
        try:
            from pmtiles.reader import Reader
            from pmtiles.tile import TileType
        except ImportError:
            raise PluginError(
                "a PMTiles file needs pmtiles on this computer: pip install 'lfield[watch]'"
            ) from None
        self.address, self.origin = OWN_ADDRESS, ""
        self._file = path.open("rb")
        self._reader: Any = cast(Any, Reader)(self._bytes)  # without types
        try:
            header: Any = _read(self._reader.header)
            if header is None:
                raise _tile_file_error(path, "its header is damaged, or of another version than 3")
            if header["tile_type"] not in (TileType.PNG, TileType.JPEG, TileType.WEBP):
                raise _tile_file_error(
                    path, "its tiles are not PNG, JPEG or WebP; vector tiles are not supported"
                )
            self.min_zoom, self.max_zoom = header["min_zoom"], min(header["max_zoom"], MAX_ZOOM)
            metadata = _read(self._reader.metadata)
            if not 0 <= self.min_zoom <= self.max_zoom or not isinstance(metadata, dict):
                raise _tile_file_error(path, "its zooms or its metadata are damaged")
        except BaseException:
            self.close()
            raise
        self.credit = str(metadata.get("attribution", ""))

    def tile(self, zoom: int, column: int, row: int) -> MapTile | None:
        """A tile; None where the file has none, or is damaged."""
        if not is_in_grid(zoom, column, row):
            return None
        return tile_of(_read(lambda: self._reader.get(zoom, column, row)))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _bytes(self, offset: int, length: int) -> bytes:
        if length > _MOST_BYTES:
            raise ValueError("a part of the file is too long")
        self._file.seek(offset)
        data = self._file.read(length)
        # The library decompresses directories and metadata as a whole.
        if data.startswith(_GZIP) and zlib.decompressobj(31).decompress(data, _MOST_BYTES)[_MOST_BYTES - 1 :]:
            raise ValueError("a directory of the file is too long")
        return data


def _read(step: Callable[[], object]) -> object:
    """A result of the library; None for damaged bytes, for which it raises many kinds of exceptions."""
    try:
        return step()
    except Exception:
        return None


def _tile_file_error(path: Path, reason: str) -> InputFileError:
    return InputFileError(str(path), f"not a PMTiles file with pictures for a map: {reason}")
