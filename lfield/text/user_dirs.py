"""Directories of a user, one rule for each purpose.

Runtime directory, for data that ends with its process (runs, control sockets):

    $RUNTIME_DIRECTORY       the directory `lfield` of a systemd unit
    $XDG_RUNTIME_DIR/lfield  if that variable names a directory that only this user may change
    /tmp/lfield-UID          else

State, cache and configuration directories, for data that outlives a process, are those of platformdirs
(XDG_STATE_HOME, XDG_CACHE_HOME, XDG_CONFIG_HOME, else the defaults in the home directory). A symbolic link of
another user is never followed, anywhere in the path: if other users may write to the parent directory, a link
could redirect to any other directory of this user.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from lfield.errors import NoHomeFolder, OutputFileError
from lfield.text.secure_files import is_trusted_dir, private_folder

#: The maximum number of path components that are followed.
_MAX_LINKS = 1000
#: The parent directory is not $TMPDIR, because a command of another environment must find the same directory.
SHARED = Path("/tmp")


# --- state, cache and configuration directories -------------------------------------------------------------


def state_dir() -> Path:
    """The directory for data that outlives a run: the directory of the unit, otherwise that of the user.

    Raises NoHomeFolder, OutputFileError.
    """
    # systemd names all state directories of a unit, separated by colons.
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(service) if service else _lfield_dir("XDG_STATE_HOME")


def config_dir() -> Path:
    """The directory of this user's settings. Raises NoHomeFolder, OutputFileError."""
    return _lfield_dir("XDG_CONFIG_HOME")


def cache_dir() -> Path:
    """The directory for data that can be regenerated, created on demand, private to this user.

    Raises NoHomeFolder, and OutputFileError if other users could write to it.
    """
    return private_folder(_lfield_dir("XDG_CACHE_HOME"))


def _lfield_dir(variable: str) -> Path:
    """The directory of lfield that platformdirs has for a variable, by a path without symbolic links."""
    # Imported here, so that a command that needs no such directory starts sooner.
    import platformdirs

    paths: dict[str, Callable[[str], Path]] = {
        "XDG_STATE_HOME": platformdirs.user_state_path,
        "XDG_CONFIG_HOME": platformdirs.user_config_path,
        "XDG_CACHE_HOME": platformdirs.user_cache_path,
    }
    try:
        found = paths[variable]("lfield")
    except RuntimeError:
        raise NoHomeFolder(variable) from None
    return resolve_own_links(found)


def resolve_own_links(path: Path) -> Path:
    """The target of an absolute path, following only links of this user and root.

    Raises OutputFileError for a link of another user anywhere on the path.
    """
    resolved, parts = Path(path.anchor), list(reversed(path.parts[1:]))
    for _ in range(_MAX_LINKS):
        if not parts:
            return resolved
        part = parts.pop()
        if part == "..":
            resolved = resolved.parent
            continue
        target = _target(resolved / part)
        if not target:
            resolved = resolved / part
        else:
            link = Path(target)
            resolved = Path(link.anchor) if link.is_absolute() else resolved
            parts += reversed(link.parts[1:] if link.is_absolute() else link.parts)
    raise OutputFileError(str(path), "there are too many symbolic links on the way")


def _target(path: Path) -> str:
    """The target of a symbolic link, '' for another kind of file or an unreadable one. Raises
    OutputFileError."""
    try:
        found = os.lstat(path)
        if not stat.S_ISLNK(found.st_mode):
            return ""
        target = os.readlink(path)
    except OSError:
        return ""
    if found.st_uid not in (0, os.geteuid()):
        raise OutputFileError(str(path), "it is a symbolic link of another user; remove it")
    return target


# --- runtime directory --------------------------------------------------------------------------------------


def runtime_dir() -> Path:
    """The runtime directory of this process; it need not exist."""
    return service_runtime_dir() or session_runtime_dir() or shared_runtime_dir()


def service_runtime_dir() -> Path | None:
    """The directory that `RuntimeDirectory=lfield` of a systemd unit made for this process."""
    paths = os.environ.get("RUNTIME_DIRECTORY", "").split(":")
    return next((Path(path) for path in paths if Path(path).name == "lfield"), None)


def session_runtime_dir() -> Path | None:
    """The directory in $XDG_RUNTIME_DIR, if only this user may change it."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    with suppress(OSError, OutputFileError):
        # After `su` the variable may name a directory of another user.
        if os.path.isabs(base) and os.stat(resolve_own_links(Path(base))).st_uid == os.geteuid():
            return Path(base) / "lfield" if is_trusted_dir(Path(base)) else None
    return None


def shared_runtime_dir() -> Path:
    """The directory of this user in /tmp."""
    return SHARED / f"lfield-{os.geteuid()}"


def private_runtime_dir(name: str) -> Path:
    """A directory of that name in the runtime directory, created on demand, private to this user.

    Raises OutputFileError if other users could write to it or remove it.
    """
    base = runtime_dir()
    if base.parent == SHARED and not is_trusted_dir(SHARED):
        raise OutputFileError(str(SHARED), "others could remove files in it")
    return private_folder(private_folder(base) / name)
