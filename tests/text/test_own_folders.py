"""Where a user's own folders are, and whoever has no home."""

from __future__ import annotations

import os
import pwd
from pathlib import Path

import pytest

from lfield.errors import NoHome
from lfield.text.own_folders import own_folder, state_folder


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
