"""Where a user's own folders are, and whoever has no home."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from lfield.authority.folder import own_settings
from lfield.errors import NoHome, OutputFileError
from lfield.text.own_folders import cache_folder, own_folder, runtime_folder, state_folder


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


def foreign(link: Path, target: Path) -> None:
    """A symbolic link of another user."""
    link.symlink_to(target)
    os.chown(link, 54321, 54321, follow_symlinks=False)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a link that belongs to another user")
@pytest.mark.parametrize("variable", _FOLDERS)
@pytest.mark.parametrize("where", ["the folder", "above", "above that", "behind a link"])
def test_a_link_of_another_user_is_not_followed(monkeypatch, tmp_path, variable, where):
    """In a base folder that others may write to, such as /tmp, another user may have made it first."""
    target, base = tmp_path / "sources", tmp_path / "base"
    (target / "in").mkdir(mode=0o700, parents=True)
    if where == "the folder":
        base.mkdir()
        foreign(link := base / "lfield", target)
    elif where == "above":
        foreign(link := base, target)
    elif where == "above that":
        foreign(link := tmp_path / "shared", target)
        base = link / "in"
    else:
        base.mkdir()
        foreign(link := tmp_path / "shared", target)
        (base / "lfield").symlink_to("../shared")
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv(variable, str(base))
    with pytest.raises(OutputFileError, match="symbolic link of another user") as refused:
        _FOLDERS[variable]()
    assert refused.value.path == str(link)
    assert [path.name for path in target.rglob("*")] == ["in"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a link that belongs to another user")
def test_a_runtime_folder_by_a_link_of_another_user_is_none(monkeypatch, tmp_path):
    (tmp_path / "mine").mkdir(mode=0o700)
    foreign(tmp_path / "run", tmp_path / "mine")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    assert runtime_folder() is None
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "mine"))
    assert runtime_folder() == tmp_path / "mine"


def test_links_that_lead_round_are_refused(monkeypatch, tmp_path):
    (tmp_path / "lfield").symlink_to(tmp_path / "other")
    (tmp_path / "other").symlink_to("lfield")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(OutputFileError, match="too many symbolic links"):
        cache_folder()


@pytest.mark.parametrize("variable", _FOLDERS)
def test_a_link_of_this_user_is_followed(monkeypatch, tmp_path, variable):
    target = tmp_path / "disk"
    target.mkdir(mode=0o700)
    (tmp_path / "lfield").symlink_to(target)
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    assert _FOLDERS[variable]() == target
