"""State, cache and configuration folders of a user: environment variables, missing home, symbolic links."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from lfield.errors import NoHomeFolder, OutputFileError
from lfield.text.user_dirs import cache_dir, config_dir, session_runtime_dir, state_dir


@pytest.mark.parametrize(
    ("variables", "folder"),
    [
        ({"XDG_STATE_HOME": "/named", "HOME": "/home/me"}, "/named/lfield"),
        ({"XDG_STATE_HOME": "named", "HOME": "/home/me"}, "/home/me/.local/state/lfield"),
        ({"XDG_STATE_HOME": "", "HOME": "/home/me"}, "/home/me/.local/state/lfield"),
        ({"XDG_STATE_HOME": "/named", "HOME": "relative"}, "/named/lfield"),
    ],
)
def test_xdg_variable_precedes_home_and_relative_paths_are_ignored(monkeypatch, variables, folder):
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert state_dir() == Path(folder)


@pytest.mark.parametrize("home", ["", ".", "relative"])
def test_unknown_user_without_an_absolute_home_has_no_folder(monkeypatch, home):
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_STATE_HOME", raising=False)
    monkeypatch.setenv("HOME", home)
    monkeypatch.setattr(os, "getuid", lambda: 54321)
    with pytest.raises(NoHomeFolder, match=r"no home folder: set HOME, or XDG_STATE_HOME, to the absolute"):
        state_dir()


def test_home_of_the_user_is_used_without_home_variable(monkeypatch):
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    assert config_dir() == Path(pwd.getpwuid(os.getuid()).pw_dir, ".config/lfield")


def test_service_needs_no_home(monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/lfield:/var/lib/other")
    monkeypatch.setenv("HOME", "")
    assert state_dir() == Path("/var/lib/lfield")


_FOLDERS = {
    "XDG_STATE_HOME": state_dir,
    "XDG_CACHE_HOME": cache_dir,
    "XDG_CONFIG_HOME": config_dir,
}


def link_of_another_user(link: Path, target: Path) -> None:
    """Creates a symbolic link that belongs to another user."""
    link.symlink_to(target)
    os.chown(link, 54321, 54321, follow_symlinks=False)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a link that belongs to another user")
@pytest.mark.parametrize("variable", _FOLDERS)
@pytest.mark.parametrize("position", ["folder", "parent", "grandparent", "link target"])
def test_link_of_another_user_is_not_followed(monkeypatch, tmp_path, variable, position):
    """In a shared base folder, such as /tmp, another user may have created the link first."""
    target, base = tmp_path / "sources", tmp_path / "base"
    (target / "in").mkdir(mode=0o700, parents=True)
    if position == "folder":
        base.mkdir()
        link_of_another_user(link := base / "lfield", target)
    elif position == "parent":
        link_of_another_user(link := base, target)
    elif position == "grandparent":
        link_of_another_user(link := tmp_path / "shared", target)
        base = link / "in"
    else:
        base.mkdir()
        link_of_another_user(link := tmp_path / "shared", target)
        (base / "lfield").symlink_to("../shared")
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv(variable, str(base))
    with pytest.raises(OutputFileError, match="symbolic link of another user") as refused:
        _FOLDERS[variable]()
    assert refused.value.path == str(link)
    assert [path.name for path in target.rglob("*")] == ["in"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a link that belongs to another user")
def test_runtime_folder_by_a_link_of_another_user_is_not_used(monkeypatch, tmp_path):
    (tmp_path / "mine").mkdir(mode=0o700)
    link_of_another_user(tmp_path / "run", tmp_path / "mine")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    assert session_runtime_dir() is None
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "mine"))
    assert session_runtime_dir() == tmp_path / "mine" / "lfield"


def test_cyclic_links_are_refused(monkeypatch, tmp_path):
    (tmp_path / "lfield").symlink_to(tmp_path / "other")
    (tmp_path / "other").symlink_to("lfield")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(OutputFileError, match="too many symbolic links"):
        cache_dir()


@pytest.mark.parametrize("variable", _FOLDERS)
def test_link_of_the_same_user_is_followed(monkeypatch, tmp_path, variable):
    target = tmp_path / "disk"
    target.mkdir(mode=0o700)
    (tmp_path / "lfield").symlink_to(target)
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv(variable, str(tmp_path))
    assert _FOLDERS[variable]() == target
