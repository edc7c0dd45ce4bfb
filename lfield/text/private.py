"""Files of this user alone: in a folder that nobody else may write to, through no link, whole or not at all.

The folder is held open while it is looked at and used: whoever swaps it in between swaps nothing. What is no
plain file (a fifo, a device, a link) is neither written nor read, so nothing here can block on one.

A group may be let read (`let_read`); it may write nowhere. What another user has written is believed only of
the `owners` that the caller names.
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
from lfield.text.files import read_up_to

#: What others must not be allowed in such a folder: to write.
_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
#: What others must not be allowed with what is secret.
_READABLE = stat.S_IRWXG | stat.S_IRWXO


def temporary_folder() -> Path:
    """The folder for what is temporary, also when its disk is full: `tempfile` looks by writing there."""
    try:
        return Path(tempfile.gettempdir())
    except OSError:
        return Path(os.environ.get("TMPDIR") or "/tmp")


def private_folder(path: Path) -> Path:
    """Make the folder if there is none, and return it. Raises OutputFileError if others could write to it."""
    with _made(path):
        return path


def new_private_folder(path: Path) -> None:
    """Make a folder that is not there yet, and the one above it if there is none. Raises OutputFileError."""
    with _made(path.parent) as parent:
        try:
            os.mkdir(path.name, 0o700, dir_fd=parent)
            # Not what the umask leaves of it.
            os.chmod(path.name, 0o700, dir_fd=parent)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None


def let_read(path: Path, group: int) -> None:
    """Let a group read a folder or plain file of this user, and nobody else; not what is in the folder.

    Where it may already, nothing changes. Raises OutputFileError.
    """
    try:
        opened = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        try:
            found = os.fstat(opened)
            _check(path, found, (os.geteuid(),))
            # A service may not chown, and need not.
            if found.st_gid != group:
                os.fchown(opened, -1, group)
            if found.st_gid != group or not found.st_mode & stat.S_IRGRP:
                os.fchmod(opened, 0o750 if stat.S_ISDIR(found.st_mode) else 0o640)
        finally:
            os.close(opened)
    except OSError as error:
        raise OutputFileError(str(path), error.strerror or str(error)) from None


def keeps(folder: Path) -> bool:
    """Whether nobody but this user and root can take away what this user makes in a folder."""
    try:
        found = folder.stat()
    except OSError:
        return False
    # Its sticky bit leaves everybody what is theirs, but for its owner.
    is_safe = not found.st_mode & _WRITABLE or found.st_mode & stat.S_ISVTX
    return found.st_uid in (0, os.geteuid()) and bool(is_safe)


def write_private(path: Path, data: bytes, mode: int = 0o600, *, durable: bool = False) -> None:
    """Write a whole file, which only this user may read, or leave what was there. Raises OutputFileError.

    The folder is made if there is none. `durable`: it is on the disk when this returns.
    """
    with _made(path.parent) as folder:
        try:
            _refuse_strange(path, folder)
            _replace(path.name, data, mode, folder, durable=durable)
            if durable:
                os.fsync(folder)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None


@contextmanager
def private_locked(path: Path) -> Iterator[None]:
    """Have a folder for this process alone among those that lock it; it is made if there is none.

    Whoever comes second waits. The lock ends with its process however that ends. Raises OutputFileError.
    """
    with _made(path) as folder:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
        except OSError as error:
            raise OutputFileError(str(path), error.strerror or str(error)) from None
        yield


@contextmanager
def private_opened(path: Path, owners: Collection[int] = ()) -> Iterator[int]:
    """The descriptor of a folder that is there, for the duration; raises OSError.

    Also when it belongs to nobody of `owners` (user numbers; by default this user) or others may write to it.
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


def read_private(path: Path, most: int, owners: Collection[int] = (), *, secret: bool = False) -> bytes:
    """What `write_private` has written; raises OSError.

    Also when anybody but `owners` could have written it (see `private_opened`), or it is larger than `most`,
    and where it is `secret`, when others may read it.
    """
    with private_opened(path.parent, owners) as folder:
        descriptor = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    with open(descriptor, "rb") as file:
        found = os.fstat(descriptor)
        if not stat.S_ISREG(found.st_mode) or found.st_uid not in (owners or (os.geteuid(),)):
            raise PermissionError(errno.EPERM, "it is no plain file of this user", str(path))
        if found.st_mode & _WRITABLE:
            raise PermissionError(errno.EPERM, "others may write to it", str(path))
        if secret and found.st_mode & _READABLE:
            raise PermissionError(
                errno.EPERM, f"it is secret, and others may read it: run 'chmod 600 {path}'", str(path)
            )
        data = read_up_to(file, most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), str(path))
    return data


_FOLDER = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW


@contextmanager
def _made(path: Path) -> Iterator[int]:
    """The folder's descriptor for the duration; it is made if there is none."""
    try:
        for missing in [above for above in reversed(path.parents) if not above.exists()]:
            # By itself mkdir would make those above as the umask says.
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
    # Not Path.is_symlink: it raises where this user may not look, or a name is too long.
    if os.path.islink(path):
        return "it is a link; name the folder that is meant"
    if error.errno in (errno.EEXIST, errno.ENOTDIR):
        return "it is not a folder"
    return error.strerror or str(error)


def _check(path: Path, found: os.stat_result, owners: Collection[int]) -> None:
    if found.st_uid not in owners:
        raise OutputFileError(
            str(path), f"the folder belongs to another user, {_named(found.st_uid)}; name one of your own"
        )
    if found.st_mode & _WRITABLE:
        raise OutputFileError(
            str(path), f"others may write to the folder: run 'chmod go-w {path}', or name another"
        )


def _named(user: int) -> str:
    with suppress(KeyError):
        return f"{pwd.getpwuid(user).pw_name} (number {user})"
    return f"number {user}"


def _refuse_strange(path: Path, folder: int) -> None:
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.stat(path.name, dir_fd=folder, follow_symlinks=False).st_mode):
            raise OutputFileError(str(path), "it is there and is no plain file; remove it")


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
