"""Map background from an MBTiles file, a SQLite database of pictures.

MBTiles 1.3: table `tiles` (zoom_level, tile_column, tile_row, tile_data) with rows counted from the south,
while browsers count from the north; table `metadata` (name, value). Pictures only, no vector tiles.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from lfield.errors import InputFileError
from lfield.operator.web.tiles.map_tiles import MAX_ZOOM, OWN_ADDRESS, MapTile, is_in_grid, tile_of

_USABLE = "from tiles where typeof(zoom_level) = 'integer' and zoom_level between ? and ?"
_ZOOMS = f"select min(zoom_level), max(zoom_level) {_USABLE}"
_SAMPLE = f"select tile_data {_USABLE} limit 1"


class MbtilesSource:
    """A `MapBackground`: the tiles of one file."""

    def __init__(self, path: Path) -> None:
        """Raises InputFileError for a file that cannot be read, or has no pictures for a map."""
        self._path = path
        self.address, self.origin = OWN_ADDRESS, ""
        try:
            self._database = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        except sqlite3.Error as error:
            raise _tile_file_error(path, str(error)) from None
        try:
            self._check()
        except BaseException:
            self.close()
            raise

    def _check(self) -> None:
        """Read the metadata of the file. Raises InputFileError."""
        path = self._path
        try:
            zooms = self._database.execute(_ZOOMS, (0, MAX_ZOOM)).fetchone()
            sample = self._database.execute(_SAMPLE, (0, MAX_ZOOM)).fetchone()
            others = self._database.execute("select zoom_level from tiles limit 1").fetchone()
            self.credit = self._metadata("attribution")
        except sqlite3.Error as error:
            raise _tile_file_error(path, str(error)) from None
        if sample is None:
            zoomed = f", only of zoom {others[0]!r}" if others is not None else ""
            raise _tile_file_error(path, f"it has no tiles of zoom 0 to {MAX_ZOOM}{zoomed}")
        if tile_of(sample[0]) is None:
            raise _tile_file_error(
                path, "its tiles are not pictures (PNG, JPEG or WebP); vector tiles are not supported"
            )
        self.min_zoom, self.max_zoom = zooms

    def tile(self, zoom: int, column: int, row: int) -> MapTile | None:
        """The tile, its row counted from the north as browsers do; None where the file has none."""
        if not is_in_grid(zoom, column, row):
            return None
        question = "select tile_data from tiles where zoom_level = ? and tile_column = ? and tile_row = ?"
        try:
            with closing(self._database.execute(question, (zoom, column, (1 << zoom) - 1 - row))) as found:
                line = found.fetchone()
        except sqlite3.Error:
            # A tile in a damaged part of the file is missing.
            return None
        return None if line is None else tile_of(line[0])

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def _metadata(self, name: str) -> str:
        try:
            found = self._database.execute("select value from metadata where name = ?", (name,)).fetchone()
        except sqlite3.Error:
            return ""
        return str(found[0]) if found else ""


def _tile_file_error(path: Path, reason: str) -> InputFileError:
    return InputFileError(
        str(path), f"neither a PMTiles nor an MBTiles file with pictures for a map: {reason}"
    )
