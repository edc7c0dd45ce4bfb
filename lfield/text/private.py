"""Files of this user alone: in a folder that nobody else may write to, through no link, whole or not at all.

The folder is held open while it is looked at and used: whoever swaps it in between swaps nothing. What is no
plain file (a fifo, a device, a link) is neither written nor read, so nothing here can block on one.
"""

from __future__ import annotations

import errno
import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lfield.errors import OutputFileError

#: What others must not be allowed in such a folder: to write.
_WRITABLE = stat.S_IWGRP | stat.S_IWOTH


def private_folder(path: Path) -> Path:
    """Make the folder if there is none, and return it. Raises OutputFileError if others could write to it."""
    with _opened(path):
        return path


def write_private(path: Path, data: bytes, *, durable: bool = False) -> None:
    """Write a whole file, which only this user may read, or leave what was there. Raises OutputFileError.

    The folder is made if there is none. `durable`: it is on the disk when this returns.
    """
    with _opened(path.parent) as folder:
        try:
            _refuse_strange(path, folder)
            _replace(path.name, data, folder, durable=durable)
            if durable:
                os.fsync(folder)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None


def read_private(path: Path, most: int) -> bytes:
    """What `write_private` has written; raises OSError.

    Also when others could have written it, or it is larger than `most`.
    """
    folder = os.open(path.parent, _FOLDER)
    try:
        _check(path.parent, os.fstat(folder))
        descriptor = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    except OutputFileError as error:
        raise PermissionError(errno.EPERM, error.reason, str(path)) from None
    finally:
        os.close(folder)
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
            raise PermissionError(errno.EPERM, "it is no plain file of this user", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return data


_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW


@contextmanager
def _opened(path: Path) -> Iterator[int]:
    """The folder's descriptor for the duration."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder = os.open(path, _FOLDER)
    except OSError as error:
        raise OutputFileError(str(path), _no_folder(path, error)) from None
    try:
        _check(path, os.fstat(folder))
        yield folder
    finally:
        os.close(folder)


def _no_folder(path: Path, error: OSError) -> str:
    if path.is_symlink():
        return "it is a link; name the folder that is meant"
    if error.errno in (errno.EEXIST, errno.ENOTDIR):
        return "it is not a folder"
    return error.strerror or str(error)


def _check(path: Path, found: os.stat_result) -> None:
    if found.st_uid != os.geteuid():
        raise OutputFileError(
            str(path), f"the folder belongs to another user (number {found.st_uid}); name one of your own"
        )
    if found.st_mode & _WRITABLE:
        raise OutputFileError(
            str(path), f"others may write to the folder: run 'chmod go-w {path}', or name another"
        )


def _refuse_strange(path: Path, folder: int) -> None:
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path.name, dir_fd=folder, follow_symlinks=False).st_mode):
            raise OutputFileError(str(path), "it is there and is no plain file; remove it")


def _replace(name: str, data: bytes, folder: int, *, durable: bool) -> None:
    temporary = f".{secrets.token_hex(8)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    descriptor = os.open(temporary, flags, 0o600, dir_fd=folder)
    try:
        with open(descriptor, "wb") as file:
            file.write(data)
            if durable:
                file.flush()
                os.fsync(descriptor)
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError:
        os.unlink(temporary, dir_fd=folder)
        raise
