"""Private files of this user: in folders that other users cannot write to, without links, written atomically.

The folder is held open while it is checked and used, so that it cannot be replaced in between. Only plain
files are read or written; a fifo, device or link is rejected, so no call here can block on such a file.

A group may get read access (`grant_group_read`), never write access. Files of other users are trusted only
for the `owners` that the caller names.
"""

from __future__ import annotations

import errno
import fcntl
import os
import pwd
import secrets
import stat
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lfield.errors import OutputFileError
from lfield.text.input_files import read_up_to

#: The access that other users must not have to such a folder: writing.
_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
#: The access that other users must not have to a secret file.
_READABLE = stat.S_IRWXG | stat.S_IRWXO


def temporary_dir() -> Path:
    """The folder for temporary files, also when its disk is full: `tempfile` tests it by writing there."""
    try:
        return Path(tempfile.gettempdir())
    except OSError:
        return Path(os.environ.get("TMPDIR") or "/tmp")


def private_folder(path: Path) -> Path:
    """The folder, created if it is missing. Raises OutputFileError if others could write to it."""
    with _open_or_create(path):
        return path


def new_private_folder(path: Path) -> None:
    """Create a folder that must not exist, and its parent if it is missing. Raises OutputFileError."""
    with _open_or_create(path.parent) as parent:
        try:
            os.mkdir(path.name, 0o700, dir_fd=parent)
            # The umask must not restrict the mode.
            os.chmod(path.name, 0o700, dir_fd=parent)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None


def grant_group_read(path: Path, group: int) -> None:
    """Give a group, and no others, read access to a folder or plain file of this user; not recursively.

    Without effect if the group has access. Raises OutputFileError.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            found = os.fstat(opened)
            _check(path, found, (os.geteuid(),))
            # A service may not change the group, and need not.
            if found.st_gid != group:
                os.fchown(opened, -1, group)
            if found.st_gid != group or not found.st_mode & stat.S_IRGRP:
                os.fchmod(opened, 0o750 if stat.S_ISDIR(found.st_mode) else 0o640)
        finally:
            os.close(opened)
    except OSError as error:
        raise OutputFileError(str(path), error.strerror or str(error)) from None


def is_trusted_dir(folder: Path) -> bool:
    """Whether only this user and root can remove files that this user creates in a folder."""
    try:
        found = folder.stat()
    except OSError:
        return False
    # With the sticky bit, only the owner of a file and the owner of the folder can remove it.
    is_safe = not found.st_mode & _WRITABLE or found.st_mode & stat.S_ISVTX
    return found.st_uid in (0, os.geteuid()) and bool(is_safe)


def write_private(path: Path, data: bytes, mode: int = 0o600, *, durable: bool = False) -> None:
    """Write a whole file atomically, readable only for this user. Raises OutputFileError.

    The folder is created if it is missing. `durable`: the file is on disk when the function returns.
    """
    with _open_or_create(path.parent) as folder:
        try:
            _refuse_foreign(path, folder)
            _replace(path.name, data, mode, folder, durable=durable)
            if durable:
                os.fsync(folder)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None


@contextmanager
def lock_private_folder(path: Path) -> Iterator[None]:
    """Lock a folder among cooperating processes, as a context manager; it is created if it is missing.

    Blocks while another process has the lock. The lock ends with its process. Raises OutputFileError.
    """
    with _open_or_create(path) as folder:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None
        yield


@contextmanager
def open_private_folder(path: Path, owners: Collection[int] = ()) -> Iterator[int]:
    """The descriptor of an existing folder, as a context manager; raises OSError, also if its owner is not
    one of `owners` (user ids; by default this user) or other users may write to it.
    """
    folder = os.open(path, _FOLDER)
    try:
        try:
            _check(path, os.fstat(folder), owners or (os.geteuid(),))
        except OutputFileError as error:
            raise PermissionError(errno.EPERM, error.reason, str(path)) from None
        yield folder
    finally:
        os.close(folder)


def read_private(path: Path, limit: int, owners: Collection[int] = (), *, secret: bool = False) -> bytes:
    """The contents of a file of `write_private`; raises OSError, also if a user other than `owners` could
    have written it (see `open_private_folder`), if it is larger than `limit`, or if it is `secret` and other
    users may read it.
    """
    with open_private_folder(path.parent, owners) as folder:
        descriptor = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid not in (owners or (os.geteuid(),)):
            raise PermissionError(errno.EPERM, "it is not a plain file of this user", str(path))
        if found.st_mode & _WRITABLE:
            raise PermissionError(errno.EPERM, "others may write to it", str(path))
        if secret and found.st_mode & _READABLE:
            raise PermissionError(
                errno.EPERM, f"it is secret, and others may read it: run 'chmod 600 {path}'", str(path)
            )
        data = read_up_to(file, limit + 1)
    if len(data) > limit:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return data


_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW


@contextmanager
def _open_or_create(path: Path) -> Iterator[int]:
    """The folder's descriptor, as a context manager; the folder is created if it is missing."""
    try:
        for missing in [above for above in reversed(path.parents) if not above.exists()]:
            # mkdir alone would create the parents with the mode of the umask.
            missing.mkdir(mode=0o700, exist_ok=True)
        path.mkdir(mode=0o700, exist_ok=True)
        folder = os.open(path, _FOLDER)
    except OSError as error:
        raise OutputFileError(str(path), _no_folder(path, error)) from None
    try:
        _check(path, os.fstat(folder), (os.geteuid(),))
        yield folder
    finally:
        os.close(folder)


def _no_folder(path: Path, error: OSError) -> str:
    # Path.is_symlink raises if this user has no access, or a name is too long.
    if os.path.islink(path):
        return "it is a link; name its target instead"
    if error.errno in (errno.EEXIST, errno.ENOTDIR):
        return "it is not a folder"
    return error.strerror or str(error)


def _check(path: Path, found: os.stat_result, owners: Collection[int]) -> None:
    if found.st_uid not in owners:
        raise OutputFileError(
            str(path), f"the folder belongs to another user, {_named(found.st_uid)}; name one of this user"
        )
    if found.st_mode & _WRITABLE:
        raise OutputFileError(
            str(path), f"others may write to the folder: run 'chmod go-w {path}', or name another"
        )


def _named(user: int) -> str:
    with suppress(KeyError):
        return f"{pwd.getpwuid(user).pw_name} (uid {user})"
    return f"uid {user}"


def _refuse_foreign(path: Path, folder: int) -> None:
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path.name, dir_fd=folder, follow_symlinks=False).st_mode):
            raise OutputFileError(str(path), "it exists and is not a plain file; remove it")


def _replace(name: str, data: bytes, mode: int, folder: int, *, durable: bool) -> None:
    temporary = f".{secrets.token_hex(8)}"
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    descriptor = os.open(temporary, flags, 0o600, dir_fd=folder)
    try:
        with open(descriptor, "wb") as file:
            os.fchmod(descriptor, mode)
            file.write(data)
            if durable:
                file.flush()
                os.fsync(descriptor)
        os.replace(temporary, name, src_dir_fd=folder, dst_dir_fd=folder)
    except OSError:
        os.unlink(temporary, dir_fd=folder)
        raise
