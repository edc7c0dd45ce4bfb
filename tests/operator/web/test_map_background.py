"""Backgrounds of the map: the requested tile, and a sentence for an invalid file or address."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest
from pmtiles.tile import Compression, TileType, zxy_to_tileid
from pmtiles.writer import Writer

from lfield.errors import InputFileError, UsageError
from lfield.operator.web.tiles.background import open_background
from lfield.operator.web.tiles.map_tiles import MapTile
from lfield.operator.web.tiles.mbtiles import MbtilesSource

PNG = b"\x89PNG\r\n\x1a\n"
# : A complete image of one transparent pixel.
PICTURE = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c489"
    "0000000d49444154789c6360606060000000050001a5f645400000000049454e44ae426082"
)


def made(path, rows, metadata=(("attribution", "a survey"),)):
    database = sqlite3.connect(path)
    database.execute(
        "create table tiles (zoom_level integer, tile_column integer, tile_row integer, tile_data blob)"
    )
    database.execute("create table metadata (name text, value text)")
    database.executemany("insert into tiles values (?, ?, ?, ?)", rows)
    database.executemany("insert into metadata values (?, ?)", metadata)
    database.commit()
    database.close()
    return path


def test_tile_rows_are_counted_from_the_north(tmp_path):
    path = made(tmp_path / "a.mbtiles", [(2, 1, 0, PNG + b"south"), (2, 1, 3, PNG + b"north")])
    with closing(MbtilesSource(path)) as tiles:
        assert tiles.tile(2, 1, 0).data == PNG + b"north"
        assert tiles.tile(2, 1, 3).data == PNG + b"south"
        assert tiles.tile(2, 1, 0).kind == "image/png"
        assert (tiles.min_zoom, tiles.max_zoom, tiles.credit) == (2, 2, "a survey")


@pytest.mark.parametrize(
    "at", [(2, 0, 0), (3, 1, 0), (-1, 0, 0), (25, 0, 0), (2, 4, 0), (2, 0, -1), (2, 0, 1 << 70)]
)
def test_a_missing_tile_is_none(tmp_path, at):
    with closing(MbtilesSource(made(tmp_path / "a.mbtiles", [(2, 1, 0, PNG)]))) as tiles:
        assert tiles.tile(*at) is None


def test_a_tile_that_is_not_an_image_is_none(tmp_path):
    rows = [(1, 0, 1, PNG), (1, 1, 1, b"<script>"), (1, 0, 0, "text")]
    with closing(MbtilesSource(made(tmp_path / "a.mbtiles", rows))) as tiles:
        assert [tiles.tile(1, 1, 0), tiles.tile(1, 0, 1)] == [None, None]


def test_a_read_only_file_is_read_in_place(tmp_path):
    path = made(tmp_path / "a ?#%.mbtiles", [(0, 0, 0, PNG)])
    path.chmod(0o444)
    with closing(MbtilesSource(path)) as tiles:
        assert tiles.tile(0, 0, 0) is not None
    assert [found.name for found in tmp_path.iterdir()] == [path.name]


def no_file(folder):
    return folder / "missing.mbtiles"


def text(folder):
    (folder / "text").write_text("no database " * 200)
    return folder / "text"


def empty(folder):
    (folder / "empty").write_bytes(b"")
    return folder / "empty"


def other_database(folder):
    sqlite3.connect(folder / "other").execute("create table birds (name)").connection.close()
    return folder / "other"


def no_rows(folder):
    return made(folder / "none", [])


def vectors(folder):
    return made(folder / "vectors", [(0, 0, 0, b"\x1f\x8b\x08 compressed")])


def words_for_numbers(folder):
    return made(folder / "words", [("near", "left", "top", PNG)])


@pytest.mark.parametrize("zooms", [(-3,), (30,), (25, 26, 27), (-1, 25)])
def test_zooms_outside_the_map_range_are_refused_with_a_sentence(tmp_path, zooms):
    path = made(tmp_path / "far.mbtiles", [(zoom, 0, 0, PNG) for zoom in zooms])
    with pytest.raises(InputFileError, match=f"it has no tiles of zoom 0 to 24, only of zoom {zooms[0]}"):
        MbtilesSource(path)


def test_only_zooms_of_the_map_range_count(tmp_path):
    path = made(tmp_path / "a.mbtiles", [(zoom, 0, 0, PNG) for zoom in (-3, 2, 9, 30)])
    with closing(MbtilesSource(path)) as tiles:
        assert (tiles.min_zoom, tiles.max_zoom) == (2, 9)


def pmtiles(path, tiles, kind=TileType.PNG, metadata=None):
    with path.open("wb") as file:
        writer = Writer(file)
        for (zoom, column, row), data in sorted(tiles.items(), key=lambda each: zxy_to_tileid(*each[0])):
            writer.write_tile(zxy_to_tileid(zoom, column, row), data)
        writer.finalize({"tile_type": kind, "tile_compression": Compression.NONE}, metadata or {})
    return path


def test_pmtiles_with_directories_of_several_levels_are_read(tmp_path):
    tiles = {(6, x, y): PNG + bytes([x, y, x * y % 251]) for x in range(64) for y in range(64)}
    path = pmtiles(tmp_path / "a.pmtiles", {(0, 0, 0): PNG, **tiles}, metadata={"attribution": "a survey"})
    with closing(open_background(str(path))) as background:
        assert (background.min_zoom, background.max_zoom) == (0, 6)
        assert (background.credit, background.origin) == ("a survey", "")
        assert background.tile(6, 63, 5) == MapTile(tiles[6, 63, 5], "image/png")
        assert [background.tile(*at) for at in ((5, 0, 0), (6, 64, 0), (6, -1, 0), (25, 0, 0))] == [None] * 4


def test_damaged_pmtiles_are_refused(tmp_path):
    path = pmtiles(tmp_path / "a.pmtiles", {(0, 0, 0): PNG, (1, 0, 0): b"<script>"})
    with closing(open_background(str(path))) as background:
        assert background.tile(1, 0, 0) is None
    content = path.read_bytes()
    for changed in (
        content[:7],
        content[:60],
        b"PMTiles\2" + content[8:],
        content[:97] + b"\4" + content[98:],
    ):
        path.write_bytes(changed)
        with pytest.raises(InputFileError, match="not a PMTiles file"):
            open_background(str(path))
    with pytest.raises(InputFileError, match="vector tiles are not supported"):
        open_background(str(pmtiles(tmp_path / "v.pmtiles", {(0, 0, 0): PNG}, TileType.MVT)))
    # A damaged directory, and lengths beyond the file: no tile.
    for at, value in ((16, b"\0" * 8), (130, b"\xff" * 20), (16, b"\xff" * 8)):
        path.write_bytes(content[:at] + value + content[at + len(value) :])
        with closing(open_background(str(path))) as background:
            assert background.tile(0, 0, 0) is None


def test_tiles_of_an_address_are_requested_by_browsers():
    background = open_background("https://tiles.example.org:8443/a/{z}/{x}/{y}.png?key=1")
    assert (background.origin, background.tile(0, 0, 0)) == ("https://tiles.example.org:8443", None)
    assert "tiles.example.org" in background.credit


@pytest.mark.parametrize(
    "address",
    [
        *(
            "ftp://a/{z}/{x}/{y}",
            "https://a/{z}/{x}",
            "https://a/{z}/{x}/{y}/{s}",
            "https://{s}.a/{z}/{x}/{y}",
        ),
        *("https://me:secret@a/{z}/{x}/{y}", "https://a;script-src */{z}/{x}/{y}", "https:///{z}/{x}/{y}"),
        *("https://[::1/{z}/{x}/{y}", "https://a 'unsafe'/{z}/{x}/{y}", "https://*/{z}/{x}/{y}"),
        "https://a:99999/{z}/{x}/{y}",
    ],
)
def test_an_invalid_tile_address_is_refused(address):
    with pytest.raises(UsageError):
        open_background(address)


def test_a_folder_as_background_is_refused(tmp_path):
    with pytest.raises(InputFileError, match="not a file; expected an MBTiles or PMTiles file"):
        open_background(str(tmp_path))


@pytest.mark.parametrize(
    "make", [no_file, text, empty, other_database, no_rows, vectors, words_for_numbers, lambda f: f]
)
def test_an_invalid_background_file_is_refused_with_a_sentence(tmp_path, make):
    with pytest.raises(InputFileError, match=r"(no such file|not a file|neither a PMTiles)"):
        open_background(str(make(tmp_path)))
