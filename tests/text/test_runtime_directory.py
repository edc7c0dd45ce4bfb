"""The runtime directory of a process: its choice, and access by its user only."""

from __future__ import annotations

import os

import pytest

from lfield.errors import OutputFileError
from lfield.text import user_dirs
from lfield.text.user_dirs import private_runtime_dir, runtime_dir

_OTHER_USER = 54321


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """A directory in place of /tmp, without a runtime directory of a systemd unit or a login session."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    folder.chmod(0o1777)
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr(user_dirs, "SHARED", folder)
    return folder


def _default_dir(shared):
    return shared / f"lfield-{os.geteuid()}"


def test_unit_directory_precedes_session_directory_and_tmp(shared, tmp_path, monkeypatch):
    assert runtime_dir() == _default_dir(shared)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert runtime_dir() == tmp_path / "lfield"
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/other:/run/lfield")
    assert str(runtime_dir()) == "/run/lfield"


@pytest.mark.parametrize("value", ["", "run", "relative/run"])
def test_session_directory_must_be_absolute(shared, monkeypatch, value):
    monkeypatch.setenv("XDG_RUNTIME_DIR", value)
    assert runtime_dir() == _default_dir(shared)


def test_directory_in_tmp_does_not_depend_on_tmpdir(shared, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert runtime_dir() == _default_dir(shared)


def test_session_directory_writable_by_others_is_not_used(shared, tmp_path, monkeypatch):
    loose = tmp_path / "loose"
    loose.mkdir()
    loose.chmod(0o777)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(loose))
    assert private_runtime_dir("doors") == _default_dir(shared) / "doors"
    assert (_default_dir(shared) / "doors").stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can create a directory of another user")
def test_directory_of_another_user_is_refused(shared):
    _default_dir(shared).mkdir(mode=0o755)
    os.chown(_default_dir(shared), _OTHER_USER, _OTHER_USER)
    with pytest.raises(OutputFileError, match="belongs to another user") as refused:
        private_runtime_dir("doors")
    assert refused.value.path == str(_default_dir(shared))


def test_linked_directory_is_refused(shared, tmp_path):
    (tmp_path / "target").mkdir(mode=0o700)
    _default_dir(shared).symlink_to(tmp_path / "target")
    with pytest.raises(OutputFileError, match="link"):
        private_runtime_dir("doors")
    assert list((tmp_path / "target").iterdir()) == []


def test_directory_writable_by_others_is_refused(shared):
    private_runtime_dir("doors").chmod(0o777)
    with pytest.raises(OutputFileError, match="others may write"):
        private_runtime_dir("doors")


def test_directory_removable_by_others_is_refused(shared):
    shared.chmod(0o777)
    with pytest.raises(OutputFileError, match="others could remove files in it"):
        private_runtime_dir("doors")
