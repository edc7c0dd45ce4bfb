"""Directories of runs: where a process publishes its run, and where commands search for runs.

A run is in the runtime directory of its process (`text.user_dirs`). Root and members of the group `lfield`
use /tmp/lfield-UID instead, open to that group, because no other user can enter $XDG_RUNTIME_DIR.

A command may have another environment than the process (sudo, su, cron). It therefore searches every
directory that this rule can give for its user. Root searches those of all users, members of the group those
that the group can read, which only root and members can have opened.
"""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from stat import S_IRGRP
from typing import NamedTuple

from lfield.net.peer_credentials import ROOT, shared_group_id
from lfield.text import user_dirs
from lfield.text.secure_files import is_trusted_dir, open_private_folder

#: The runtime directory of the systemd unit in deploy/.
SERVICE = Path("/run/lfield")
#: The parent of every $XDG_RUNTIME_DIR that systemd creates; names are user ids.
SESSIONS = Path("/run/user")
_SHARED_NAME = re.compile(r"lfield-(0|[1-9]\d{0,9})", re.ASCII)


class RunLocation(NamedTuple):
    """A directory where this process may publish its run, and the group that can read it, -1 for none."""

    path: Path
    group: int = -1


class SearchRoot(NamedTuple):
    """Directories that may contain runs, and the users whose runs are trusted there.

    The directories are `foreign` if these users are neither this user, nor root, nor a service.
    """

    paths: Sequence[Path]
    owners: Collection[int]
    is_foreign: bool = False


# --- publishing ---------------------------------------------------------------------------------------------


def run_locations() -> Iterator[RunLocation]:
    """The locations where this process may publish its run, the preferred one first."""
    service = user_dirs.service_runtime_dir()
    if service is not None and service.is_dir():
        found = service.stat()
        yield RunLocation(service, found.st_gid if found.st_mode & S_IRGRP else -1)
        return
    session, shared = user_dirs.session_runtime_dir(), user_dirs.shared_runtime_dir()
    is_usable = is_trusted_dir(shared.parent)
    group = shared_group_id() if _searches_everywhere() else None
    if group is not None and is_usable:
        yield RunLocation(shared, group)
    if session is not None:
        yield RunLocation(session)
    elif is_usable:
        yield RunLocation(shared)


def is_shared_with_group() -> bool:
    """Whether runs of this process should be readable by the group `lfield`."""
    return _searches_everywhere() and shared_group_id() is not None


# --- searching ----------------------------------------------------------------------------------------------


def search_roots() -> Iterator[SearchRoot]:
    """Directories that may contain runs which this user may see."""
    service = user_dirs.service_runtime_dir() or SERVICE
    # The owner is the service: only root or this user may create anything in the parent directory.
    with suppress(OSError), open_private_folder(service.parent, (ROOT, os.geteuid())):
        yield SearchRoot((service,), {ROOT, service.lstat().st_uid})
    yield SearchRoot([path for path in _own_dirs() if path != service], {os.geteuid()})
    if not _searches_everywhere():
        return
    group = shared_group_id()
    for user, paths in _dirs_of_others().items():
        # Only root and members of the group can have set the group of a directory.
        if own_paths := [path for path in paths if _is_root() or _group_of(path) == group]:
            yield SearchRoot(own_paths, {user}, is_foreign=user != ROOT)


def unreadable_hint() -> str:
    """The remedy for a service's runs that this user may not see; '' when there can be none."""
    service = user_dirs.service_runtime_dir() or SERVICE
    if not service.exists() or os.access(service, os.R_OK | os.X_OK):
        return ""
    return f"what runs in {service} this user may not see: use sudo, or join the group of that folder"


def searched_dirs() -> list[str]:
    """The names of the searched directories, for a message that no run was found."""
    places = [user_dirs.service_runtime_dir() or SERVICE, *_own_dirs()]
    if is_shared_with_group() or (_searches_everywhere() and _is_root()):
        places += [SESSIONS / "*" / "lfield", user_dirs.SHARED / "lfield-*"]
    return [str(place) for place in dict.fromkeys(places)]


def _own_dirs() -> list[Path]:
    """The directories of runs of this user, in any environment of their processes."""
    session, shared = user_dirs.session_runtime_dir(), user_dirs.shared_runtime_dir()
    if not _searches_everywhere():
        return [session or shared]
    usual = SESSIONS / str(os.geteuid()) / "lfield"
    return list(dict.fromkeys([*([session] if session is not None else []), usual, shared]))


def _dirs_of_others() -> dict[int, list[Path]]:
    """The directories of other users that have their owner's user id in their path."""
    dirs_by_owner: dict[int, list[Path]] = defaultdict(list)
    if _is_root():
        for path in sorted(SESSIONS.glob("*/lfield")):
            with suppress(OSError):
                if path.parent.name == str(path.lstat().st_uid):
                    dirs_by_owner[path.lstat().st_uid].append(path)
    with suppress(OSError), os.scandir(user_dirs.SHARED) as entries:
        for entry in entries:
            named = _SHARED_NAME.fullmatch(entry.name)
            with suppress(OSError):
                if named and entry.stat(follow_symlinks=False).st_uid == int(named[1]):
                    dirs_by_owner[int(named[1])].append(user_dirs.SHARED / entry.name)
    dirs_by_owner.pop(os.geteuid(), None)
    return dict(sorted(dirs_by_owner.items()))


def _group_of(path: Path) -> int:
    """The group of a directory; -1 if that cannot be read."""
    try:
        return path.lstat().st_gid
    except OSError:
        return -1


def _searches_everywhere() -> bool:
    """Whether directories of other environments count: not with LFIELD_RUNS=here."""
    return os.environ.get("LFIELD_RUNS", "") != "here"


def _is_root() -> bool:
    return os.geteuid() == ROOT
