"""Where a user's own folders are, and whoever has no home."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from lfield.authority.folder import own_settings
from lfield.errors import NoHome, OutputFileError
from lfield.text.own_folders import cache_folder, own_folder, state_folder


@pytest.mark.parametrize(
    ("environment", "folder"),
    [
        ({"VARIABLE": "/named", "HOME": "/home/me"}, "/named"),
        ({"VARIABLE": "named", "HOME": "/home/me"}, "/home/me/.place/in"),
        ({"VARIABLE": "", "HOME": "/home/me"}, "/home/me/.place/in"),
        ({"VARIABLE": "/named", "HOME": "relative"}, "/named"),
    ],
)
def test_the_variable_counts_before_the_home(environment, folder):
    assert own_folder("VARIABLE", ".place/in", environment) == Path(folder)


@pytest.mark.parametrize("home", ["", ".", "relative"])
def test_a_home_that_is_no_absolute_path_is_none(home):
    with pytest.raises(NoHome, match=r"no home folder: set HOME, or VARIABLE, to the absolute path"):
        own_folder("VARIABLE", ".place", {"HOME": home})


def test_where_no_home_is_named_it_is_that_of_the_user(monkeypatch):
    home = pwd.getpwuid(os.geteuid()).pw_dir
    assert own_folder("VARIABLE", ".place", {}) == Path(home, ".place")


def test_a_user_whom_nobody_knows_has_none(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 54321)
    with pytest.raises(NoHome):
        own_folder("VARIABLE", ".place", {})


def test_a_service_needs_no_home(monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/lfield:/var/lib/other")
    monkeypatch.setenv("HOME", "")
    assert state_folder() == Path("/var/lib/lfield")


_FOLDERS = {
    "XDG_STATE_HOME": state_folder,
    "XDG_CACHE_HOME": cache_folder,
    "XDG_CONFIG_HOME": lambda: own_settings(os.environ),
}


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a link that belongs to another user")
@pytest.mark.parametrize("variable", _FOLDERS)
def test_a_link_of_another_user_is_not_followed(monkeypatch, tmp_path, variable):
    """In a base folder that others may write to, such as /tmp, another user may have made it first."""
    target = tmp_path / "sources"
    target.mkdir(mode=0o700)
    link = tmp_path / "lfield"
    link.symlink_to(target)
    os.chown(link, 54321, 54321, follow_symlinks=False)
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    with pytest.raises(OutputFileError) as refused:
        _FOLDERS[variable]()
    assert refused.value.path == str(link)
    assert list(target.iterdir()) == []


@pytest.mark.parametrize("variable", _FOLDERS)
def test_a_link_of_this_user_is_followed(monkeypatch, tmp_path, variable):
    target = tmp_path / "disk"
    target.mkdir(mode=0o700)
    (tmp_path / "lfield").symlink_to(target)
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    assert _FOLDERS[variable]() == target
