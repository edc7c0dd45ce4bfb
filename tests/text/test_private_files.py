"""Private files of one user: no links, no folders of other users, atomic writes, no blocking on a FIFO."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from lfield.errors import OutputFileError
from lfield.text.secure_files import (
    grant_group_read,
    is_trusted_dir,
    new_private_folder,
    private_folder,
    read_private,
    write_private,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "folder" / "file"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


def assert_write_refused(path: Path, words: str) -> None:
    with pytest.raises(OutputFileError, match=words):
        write_private(path, b"new")


def test_written_file_is_readable_by_its_user_only(path):
    before = os.umask(0)
    try:
        write_private(path, b"data")
    finally:
        os.umask(before)
    assert (mode(path.parent), mode(path)) == (0o700, 0o600)
    assert read_private(path, 4) == b"data"
    assert list(path.parent.iterdir()) == [path]
    with pytest.raises(OSError, match="too large"):
        read_private(path, 3)


def test_existing_folder_keeps_its_mode(path):
    path.parent.mkdir(parents=True)
    path.parent.chmod(0o755)
    write_private(path, b"data")
    assert (mode(path.parent), mode(path)) == (0o755, 0o600)


@pytest.mark.parametrize("mode_bits", [0o770, 0o707, 0o777, 0o1777])
def test_folder_writable_by_others_is_refused(path, mode_bits):
    path.parent.mkdir(parents=True)
    path.write_bytes(b"old")
    path.parent.chmod(mode_bits)
    assert_write_refused(path, "others may write to the folder: run 'chmod go-w .*folder', or name another")
    assert path.read_bytes() == b"old"
    with pytest.raises(PermissionError):
        read_private(path, 10)


def test_folder_of_another_user_is_refused(path, monkeypatch):
    path.parent.mkdir(parents=True)
    path.write_bytes(b"old")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert_write_refused(path, "the folder belongs to another user")
    with pytest.raises(PermissionError):
        read_private(path, 10)
    assert path.read_bytes() == b"old"


def test_file_of_another_user_is_read_from_named_owners_only(path, monkeypatch):
    write_private(path, b"data")
    writer = os.getuid()
    monkeypatch.setattr(os, "geteuid", lambda: writer + 1)
    with pytest.raises(PermissionError):
        read_private(path, 10)
    with pytest.raises(PermissionError):
        read_private(path, 10, owners={writer + 2})
    assert read_private(path, 10, owners={writer}) == b"data"


@pytest.mark.parametrize("mode_bits", [0o620, 0o602, 0o666])
def test_file_writable_by_others_is_not_read(path, mode_bits):
    write_private(path, b"data")
    path.chmod(mode_bits)
    with pytest.raises(PermissionError, match="others may write to it"):
        read_private(path, 10)


def test_group_read_is_granted_despite_the_umask(path):
    before = os.umask(0o077)
    try:
        new_private_folder(path.parent)
        write_private(path, b"data")
        for entry in (path, path.parent):
            grant_group_read(entry, os.getegid())
    finally:
        os.umask(before)
    assert (mode(path.parent.parent), mode(path.parent), mode(path)) == (0o700, 0o750, 0o640)


def test_existing_group_read_is_unchanged(path):
    """A service may have other permissions on its folder, and no right to change its group."""
    path.parent.mkdir(parents=True)
    path.parent.chmod(0o755)
    grant_group_read(path.parent, os.getegid())
    assert mode(path.parent) == 0o755


@pytest.mark.parametrize("kind", ["link", "writable"])
def test_group_read_is_refused_for_links_and_writable_folders(path, tmp_path, kind):
    private_folder(path.parent)
    other_folder = tmp_path / "other_folder"
    other_folder.mkdir(mode=0o700)
    if kind == "link":
        path.symlink_to(other_folder)
    else:
        path.mkdir()
        path.chmod(0o770)
    with pytest.raises(OutputFileError):
        grant_group_read(path, os.getegid())
    assert mode(other_folder) == 0o700


@pytest.mark.parametrize(
    ("mode_bits", "is_trusted"),
    [(0o700, True), (0o755, True), (0o1777, True), (0o777, False), (0o770, False)],
)
def test_trusted_folder_keeps_files_from_others(tmp_path, monkeypatch, mode_bits, is_trusted):
    tmp_path.chmod(mode_bits)
    assert is_trusted_dir(tmp_path) == is_trusted
    assert not is_trusted_dir(tmp_path / "nowhere")
    if os.getuid():
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
        assert not is_trusted_dir(tmp_path)


def test_new_folder_must_not_exist(path):
    private_folder(path.parent)
    with pytest.raises(OutputFileError, match="folder: File exists"):
        new_private_folder(path.parent)
    path.symlink_to(path.parent)
    with pytest.raises(OutputFileError, match="file: File exists"):
        new_private_folder(path)


def test_link_or_file_in_place_of_a_folder_is_refused(path, tmp_path):
    path.parent.parent.mkdir()
    path.parent.symlink_to(tmp_path)
    assert_write_refused(path, "it is a link; name its target instead")
    path.parent.unlink()
    path.parent.write_bytes(b"")
    assert_write_refused(path, "it is not a folder")
    path.parent.unlink()
    os.mkfifo(path.parent)
    assert_write_refused(path, "it is not a folder")
    with pytest.raises(OutputFileError, match="cannot write /proc/nowhere: No such file"):
        private_folder(Path("/proc/nowhere"))


def test_link_is_neither_written_through_nor_read(path, tmp_path):
    private_folder(path.parent)
    target = tmp_path / "target"
    target.write_bytes(b"old")
    path.symlink_to(target)
    assert_write_refused(path, "is not a plain file; remove it")
    with pytest.raises(OSError, match="symbolic links"):
        read_private(path, 10)
    assert target.read_bytes() == b"old"


def test_hard_links_of_a_file_keep_the_old_content(path, tmp_path):
    private_folder(path.parent)
    target = tmp_path / "target"
    target.write_bytes(b"old")
    path.hardlink_to(target)
    write_private(path, b"new")
    assert (path.read_bytes(), target.read_bytes()) == (b"new", b"old")


def test_fifo_does_not_block(path):
    private_folder(path.parent)
    os.mkfifo(path)
    assert_write_refused(path, "is not a plain file; remove it")
    with pytest.raises(PermissionError):
        read_private(path, 10)


def test_unfinished_write_keeps_the_old_file(path, monkeypatch):
    write_private(path, b"old")

    def full(*arguments: object, **more: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert_write_refused(path, "No space left on device")
    assert list(path.parent.iterdir()) == [path]
    assert path.read_bytes() == b"old"


def test_folder_with_too_long_a_name_is_refused(tmp_path):
    assert_write_refused(tmp_path / ("x" * 300) / "file", "too long")
