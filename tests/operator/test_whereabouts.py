"""The note that `up --all` leaves for `ps`: who finds it, and what is not believed."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from lfield.operator import whereabouts

DEPLOYMENT = b"d" * 32
ADDRESSES = {"alpha": "127.0.0.1:4001", "bravo": "127.0.0.1:4002"}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / f"lfield-{os.getuid()}"


def left(folder, text):
    """A note with this text, as somebody else left it."""
    folder.mkdir(mode=0o700)
    (folder / f"{DEPLOYMENT.hex()[:32]}.json").write_text(text)


def test_addresses_are_found_while_they_are_published():
    assert whereabouts.find(DEPLOYMENT) == {}
    with whereabouts.published(DEPLOYMENT, ADDRESSES, pytest.fail):
        assert whereabouts.find(DEPLOYMENT) == ADDRESSES
        assert whereabouts.find(b"e" * 32) == {}
    assert whereabouts.find(DEPLOYMENT) == {}


def test_only_their_user_can_read_them_and_nothing_is_left_behind(folder):
    with whereabouts.published(DEPLOYMENT, ADDRESSES, pytest.fail):
        (note,) = folder.iterdir()
        assert (folder.stat().st_mode & 0o777, note.stat().st_mode & 0o777) == (0o700, 0o600)
    assert list(folder.iterdir()) == []


def test_nothing_is_published_where_nothing_can_be_written(folder):
    folder.write_text("a file, not a folder")
    told = []
    with whereabouts.published(DEPLOYMENT, ADDRESSES, told.append):
        assert whereabouts.find(DEPLOYMENT) == {}
    assert told == [
        f"ps, query and estop need --map to find these hosts: cannot write {folder}: it is not a folder"
    ]


def test_a_folder_that_somebody_else_made_ready_is_not_used(folder, tmp_path):
    """In /tmp anybody can make it first, or a link in its place."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    folder.symlink_to(elsewhere)
    told = []
    with whereabouts.published(DEPLOYMENT, ADDRESSES, told.append):
        assert list(elsewhere.iterdir()) == []
    assert len(told) == 1
    folder.unlink()
    left(folder, json.dumps({"pid": os.getpid(), "addresses": ADDRESSES}))
    assert whereabouts.find(DEPLOYMENT) == ADDRESSES
    folder.chmod(0o777)
    assert whereabouts.find(DEPLOYMENT) == {}


def test_a_link_in_the_place_of_the_note_is_neither_written_through_nor_read(folder, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text(json.dumps({"pid": os.getpid(), "addresses": ADDRESSES}))
    folder.mkdir(mode=0o700)
    (folder / f"{DEPLOYMENT.hex()[:32]}.json").symlink_to(precious)
    assert whereabouts.find(DEPLOYMENT) == {}
    before, told = precious.read_text(), []
    with whereabouts.published(DEPLOYMENT, {"alpha": "127.0.0.1:9"}, told.append):
        assert precious.read_text() == before
    assert "no plain file" in told[0]


def test_who_starts_the_same_deployment_again_keeps_its_note(folder):
    later = json.dumps({"pid": os.getppid(), "addresses": {"alpha": "127.0.0.1:5001"}})
    with whereabouts.published(DEPLOYMENT, ADDRESSES, pytest.fail):
        (note,) = folder.iterdir()
        note.write_text(later)
    assert whereabouts.find(DEPLOYMENT) == {"alpha": "127.0.0.1:5001"}


def test_a_process_that_has_ended_is_not_believed(folder):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left(folder, json.dumps({"pid": ended.pid, "addresses": ADDRESSES}))
    assert whereabouts.find(DEPLOYMENT) == {}


@pytest.mark.parametrize(
    "note",
    [
        "",
        "{",
        "[]",
        '{"pid": OURS}',
        '{"pid": "OURS", "addresses": {}}',
        '{"pid": 0, "addresses": {"alpha": "127.0.0.1:1"}}',
        '{"pid": 1e400, "addresses": {"alpha": "127.0.0.1:1"}}',
        '{"pid": 99999999999999999999, "addresses": {"alpha": "127.0.0.1:1"}}',
        '{"pid": OURS, "addresses": ["127.0.0.1:1"]}',
        '{"pid": OURS, "addresses": {"alpha": 1}}',
        '{"pid": OURS, "addresses": {"": "127.0.0.1:1"}}',
        '{"pid": OURS, "addresses": {"alpha": "LONG"}}',
        '{"pid": OURS, "addresses": {"alpha": "127.0.0.1:1"}, "more": 1}',
    ],
)
def test_what_is_no_note_is_not_believed(folder, note):
    left(folder, note.replace("OURS", str(os.getpid())).replace("LONG", "1" * 300))
    assert whereabouts.find(DEPLOYMENT) == {}
