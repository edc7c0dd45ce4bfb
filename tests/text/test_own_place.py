"""A user's own folder beside those of strangers: nobody takes its place away."""

from __future__ import annotations

import os
import tempfile

import pytest

from lfield.errors import OutputFileError
from lfield.text.own_folders import own_place, own_places

_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can make what belongs to a stranger")
_STRANGER = 54321


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """A temporary folder as all users have one, and no runtime folder."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def _usual(shared):
    return shared / f"lfield-{os.geteuid()}"


def test_it_is_in_the_runtime_folder_where_there_is_one(shared, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert own_places("doors") == []
    assert own_place("doors") == tmp_path / "doors"
    assert own_places("doors") == [tmp_path / "doors"]


def test_else_it_is_in_the_temporary_one_under_the_users_number(shared):
    assert own_place("doors") == own_place("doors") == _usual(shared) / "doors"
    assert own_places("doors") == [_usual(shared) / "doors"]


def test_a_runtime_folder_that_others_may_write_to_is_none(shared, tmp_path, monkeypatch):
    loose = tmp_path / "loose"
    loose.mkdir()
    loose.chmod(0o777)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(loose))
    assert own_place("doors") == _usual(shared) / "doors"


@_root
def test_whoever_makes_it_first_does_not_take_it_away(shared):
    _usual(shared).mkdir(mode=0o777)
    os.chown(_usual(shared), _STRANGER, _STRANGER)
    place = own_place("doors")
    assert place.parent.name.startswith(f"{_usual(shared).name}-")
    assert place.stat().st_uid == os.geteuid()
    assert own_place("doors") == place, "the next process has the same"
    assert own_places("doors") == [place]


@_root
def test_what_strangers_have_under_such_a_name_is_not_looked_into(shared):
    other = shared / f"{_usual(shared).name}-0a1b2c3d"
    (other / "doors").mkdir(parents=True)
    os.chown(other, _STRANGER, _STRANGER)
    assert own_places("doors") == []


def test_a_folder_that_others_may_write_to_is_passed_over(shared):
    place = own_place("doors")
    place.chmod(0o777)
    assert own_places("doors") == []
    assert own_place("doors") != place


def test_where_others_could_remove_it_there_is_none(shared):
    shared.chmod(0o777)
    with pytest.raises(OutputFileError, match="others could remove what is in it"):
        own_place("doors")
