"""Where a user's own folders are.

What outlives its processes is where the environment says, else in the user's home. What is no absolute path
is not taken: the folder would be another one wherever a command is called. A symbolic link of another user is
never followed, wherever on the way it is: where others may write to the folder above, it would lead to any
other folder of this user.

What lasts as long as its processes:

    $XDG_RUNTIME_DIR        if it is the user's and nobody else may change it
    TMPDIR/lfield-UID       else

In a temporary folder anybody can make `lfield-UID` first. Whoever needs one makes one then with an end to its
name that nobody knows before, `lfield-UID-0a1b2c3d`, and none where others could remove it. So nobody can
take the place away from anybody; who looks for something there looks into all of a user's.
"""

from __future__ import annotations

import os
import pwd
import re
import secrets
import stat
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from lfield.errors import NoHome, OutputFileError
from lfield.text.private import keeps, private_folder, private_opened, temporary_folder

#: So many folders and links may be on the way to one.
_MOST_STEPS = 1000
#: A folder of a user in a temporary one.
_OF_USER = re.compile(r"lfield-(0|[1-9]\d{0,9})(-[0-9a-f]{8})?", re.ASCII)


# --- what outlives its processes ----------------------------------------------------------------------------


def own_folder(variable: str, place: str, environment: Mapping[str, str] = os.environ) -> Path:
    """The folder that a variable names, else the one at that `place` in the home. Raises NoHome."""
    for base, inside in ((environment.get(variable, ""), "."), (_home(environment), place)):
        if os.path.isabs(base):
            return Path(base) / inside
    raise NoHome(variable)


def state_folder() -> Path:
    """The folder of what outlives a run: the service's, else the user's. Raises NoHome, OutputFileError."""
    # systemd names all state folders of a unit, with colons between.
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    return Path(service) if service else lfield_in(own_folder("XDG_STATE_HOME", ".local/state"))


def cache_folder() -> Path:
    """The folder of what can be made again, made on demand, private to this user.

    Raises NoHome, and OutputFileError where there is none that others cannot write to.
    """
    return private_folder(lfield_in(own_folder("XDG_CACHE_HOME", ".cache")))


def lfield_in(base: Path) -> Path:
    """The folder `lfield` in a base folder, by a path without symbolic links. Raises OutputFileError."""
    return without_links(base / "lfield")


def without_links(place: Path) -> Path:
    """Where an absolute path leads to, by links of this user and root alone.

    Raises OutputFileError for a link of another user, also where a link leads to one.
    """
    found, parts = Path(place.anchor), list(reversed(place.parts[1:]))
    for _ in range(_MOST_STEPS):
        if not parts:
            return found
        part = parts.pop()
        if part == "..":
            found = found.parent
            continue
        target = _target(found / part)
        if not target:
            found = found / part
        else:
            link = Path(target)
            found = Path(link.anchor) if link.is_absolute() else found
            parts += reversed(link.parts[1:] if link.is_absolute() else link.parts)
    raise OutputFileError(str(place), "there are too many symbolic links on the way")


def _target(path: Path) -> str:
    """What a symbolic link leads to, '' where it is none or cannot be seen. Raises OutputFileError."""
    try:
        found = os.lstat(path)
        if not stat.S_ISLNK(found.st_mode):
            return ""
        target = os.readlink(path)
    except OSError:
        return ""
    if found.st_uid not in (0, os.geteuid()):
        raise OutputFileError(str(path), "it is a symbolic link of another user: remove it")
    return target


def _home(environment: Mapping[str, str]) -> str:
    if "HOME" in environment:
        return environment["HOME"]
    with suppress(KeyError):
        return pwd.getpwuid(os.geteuid()).pw_dir
    return ""


# --- what lasts as long as they do --------------------------------------------------------------------------


def runtime_folder() -> Path | None:
    """The runtime folder of this user, if there is one that nobody else may change."""
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    with suppress(OSError, OutputFileError):
        # After `su` it may still be another user's.
        if os.path.isabs(runtime) and os.stat(without_links(Path(runtime))).st_uid == os.geteuid():
            return Path(runtime) if keeps(Path(runtime)) else None
    return None


def new_in(shared: Path) -> Iterator[Path]:
    """Folders of this user in a temporary one, of which nobody can take the last one beforehand."""
    if not keeps(shared):
        return
    usual = _usual(shared)
    yield usual
    # Where this user may not list what is there, commands would not find what has another name.
    with suppress(OSError):
        yield from _unusual(shared)
        yield usual.with_name(f"{usual.name}-{secrets.token_hex(4)}")


def of_users(shared: Path) -> dict[int, list[Path]]:
    """The folders in a temporary one that are named after their owners, by them. Raises OSError."""
    with os.scandir(shared) as entries:
        names = sorted(entry.name for entry in entries if entry.name.startswith("lfield-"))
    found: dict[int, list[Path]] = defaultdict(list)
    for name in names:
        if named := _OF_USER.fullmatch(name):
            with suppress(OSError):
                # No path is made of it before: somebody may have put thousands there.
                owner = os.lstat(f"{shared}/{name}").st_uid
                if owner == int(named[1]):
                    found[owner].append(shared / name)
    return found


def own_place(name: str) -> Path:
    """A folder of that name of this user alone, made on demand.

    Raises OutputFileError when none can be had that others cannot write to, or take away.
    """
    first: OutputFileError | None = None
    for folder in _own():
        try:
            return private_folder(private_folder(folder) / name)
        except OutputFileError as error:
            first = first or error
    raise first or OutputFileError(str(temporary_folder()), "others could remove what is in it")


def own_places(name: str) -> list[Path]:
    """The folders of that name that `own_place` may have given, of those that nobody else can write to."""
    places = [folder / name for folder in _had()]
    return [place for place in places if _is_private(place.parent) and _is_private(place)]


def _had() -> Iterator[Path]:
    runtime, shared = runtime_folder(), temporary_folder()
    if runtime is not None:
        yield runtime
        return
    yield _usual(shared)
    with suppress(OSError):
        yield from _unusual(shared)


def _usual(shared: Path) -> Path:
    return shared / f"lfield-{os.geteuid()}"


def _unusual(shared: Path) -> list[Path]:
    """This user's that are there under another name. Raises OSError."""
    return [path for path in of_users(shared).get(os.geteuid(), ()) if path != _usual(shared)]


def _is_private(place: Path) -> bool:
    with suppress(OSError), private_opened(place):
        return True
    return False


def _own() -> Iterator[Path]:
    runtime = runtime_folder()
    return iter((runtime,)) if runtime is not None else new_in(temporary_folder())
