"""Backgrounds from MBTiles files: the tile that was asked for, and a sentence for a file that is none."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest

from lfield.errors import InputFileError
from lfield.operator.web.tiles.mbtiles import MbtilesSource

PNG = b"\x89PNG\r\n\x1a\n"


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


def test_rows_are_counted_from_the_north(tmp_path):
    path = made(tmp_path / "a.mbtiles", [(2, 1, 0, PNG + b"south"), (2, 1, 3, PNG + b"north")])
    with closing(MbtilesSource(path)) as tiles:
        assert tiles.tile(2, 1, 0).data == PNG + b"north"
        assert tiles.tile(2, 1, 3).data == PNG + b"south"
        assert tiles.tile(2, 1, 0).kind == "image/png"
        assert (tiles.min_zoom, tiles.max_zoom, tiles.credit) == (2, 2, "a survey")


@pytest.mark.parametrize(
    "at", [(2, 0, 0), (3, 1, 0), (-1, 0, 0), (25, 0, 0), (2, 4, 0), (2, 0, -1), (2, 0, 1 << 70)]
)
def test_what_is_not_there_is_no_tile(tmp_path, at):
    with closing(MbtilesSource(made(tmp_path / "a.mbtiles", [(2, 1, 0, PNG)]))) as tiles:
        assert tiles.tile(*at) is None


def test_what_is_no_picture_is_no_tile(tmp_path):
    rows = [(1, 0, 1, PNG), (1, 1, 1, b"<script>"), (1, 0, 0, "text")]
    with closing(MbtilesSource(made(tmp_path / "a.mbtiles", rows))) as tiles:
        assert [tiles.tile(1, 1, 0), tiles.tile(1, 0, 1)] == [None, None]


def test_a_file_is_read_where_it_lies(tmp_path):
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
def test_zooms_that_no_map_has_are_refused_with_a_sentence(tmp_path, zooms):
    path = made(tmp_path / "far.mbtiles", [(zoom, 0, 0, PNG) for zoom in zooms])
    with pytest.raises(InputFileError, match=f"it has no tiles of zoom 0 to 24, only of zoom {zooms[0]}"):
        MbtilesSource(path)


def test_of_many_zooms_those_count_that_a_map_has(tmp_path):
    path = made(tmp_path / "a.mbtiles", [(zoom, 0, 0, PNG) for zoom in (-3, 2, 9, 30)])
    with closing(MbtilesSource(path)) as tiles:
        assert (tiles.min_zoom, tiles.max_zoom) == (2, 9)


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(InputFileError, match="not a file; expected an MBTiles file"):
        MbtilesSource(tmp_path)


@pytest.mark.parametrize(
    "make", [no_file, text, empty, other_database, no_rows, vectors, words_for_numbers, lambda f: f]
)
def test_a_file_that_is_none_is_refused_with_a_sentence(tmp_path, make):
    with pytest.raises(InputFileError, match=r"(no such file|not a file|not an MBTiles file)"):
        MbtilesSource(make(tmp_path))
