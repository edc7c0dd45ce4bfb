"""Where runs are on this computer: one list, for whoever begins one and whoever looks for it.

    /run/lfield             the service's, made by its service manager; its group may look there
    /tmp/lfield-UID         a user's, open to the group `lfield` where that user may give files to it
    $XDG_RUNTIME_DIR/lfield a user's
    TMPDIR/lfield-UID       a user's who has no runtime folder

In a temporary folder `lfield-UID` may be followed by an end that nobody knows before (`text.own_folders`).
Who looks takes each folder in its owner's name only.

Who looks may have another environment than who began (sudo, su, cron): all folders are looked into that the
user's runs can be in without anybody having named another; root looks into those of all users, and members of
the group into those that are open to it, which only root and members can have opened.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from stat import S_IRGRP
from typing import NamedTuple

from lfield.net.door import ROOT, sharing
from lfield.text.own_folders import new_in, of_users, runtime_folder
from lfield.text.private import private_opened, temporary_folder

#: Where the unit of deploy/ has its runs.
SERVICE = Path("/run/lfield")
#: Where systemd has the runtime folders of users, by number, and where temporary files usually are.
RUNTIMES, SHARED = Path("/run/user"), Path("/tmp")
#: So many folders of another user are looked into; nobody needs more.
_MOST_OF_OTHERS = 4


class Spot(NamedTuple):
    """A folder where this process may begin a run, and the group that it is open to, -1 for none."""

    path: Path
    group: int = -1


class Base(NamedTuple):
    """Folders where runs can be, and the users whose they can be there.

    They are `foreign` where these are neither who looks, nor root, nor a service.
    """

    paths: Sequence[Path]
    owners: Collection[int]
    is_foreign: bool = False


# --- for who begins one -------------------------------------------------------------------------------------


def spots() -> Iterator[Spot]:
    """Where this process may have its run, the best first."""
    service = _service()
    if service is not None and service.is_dir():
        found = service.stat()
        yield Spot(service, found.st_gid if found.st_mode & S_IRGRP else -1)
        return
    group = sharing() if _elsewhere() else None
    if group is not None:
        yield from (Spot(path, group) for path in new_in(SHARED))
    runtime = _runtime()
    if runtime is not None:
        yield Spot(runtime)
    for folder in _temporary():
        yield from (Spot(path) for path in new_in(folder))


def for_group() -> bool:
    """Whether runs of this process are open to the group `lfield`, if nothing is in the way."""
    return _elsewhere() and sharing() is not None


# --- for who looks ------------------------------------------------------------------------------------------


def bases() -> Iterator[Base]:
    """Where runs can be that this user may see."""
    service = _service() or SERVICE
    # Where only root may write, the service manager has made it: whoever it belongs to is the service.
    with suppress(OSError), private_opened(service.parent, (ROOT, os.geteuid())):
        yield Base((service,), {ROOT, service.lstat().st_uid})
    found = _by_user()
    own = dict.fromkeys((*_of_this_user(), *found.pop(os.geteuid(), ())))
    yield Base([path for path in own if path != service], {os.geteuid()})
    group = sharing()
    for user, paths in found.items() if _elsewhere() else ():
        # What a member takes notice of, only root and members can have opened.
        some = paths[:_MOST_OF_OTHERS]
        if seen := [path for path in some if _for_all() or _group_of(path) == group]:
            yield Base(seen, {user}, is_foreign=user != ROOT)


def unseen() -> str:
    """What to do for a service's runs that this user may not see; '' when there can be none."""
    service = _service() or SERVICE
    if not service.exists() or os.access(service, os.R_OK | os.X_OK):
        return ""
    return f"what runs in {service} this user may not see: use sudo, or join the group of that folder"


def looked_into() -> list[str]:
    """The names of all these places, for somebody who has found nothing there."""
    places = [_service() or SERVICE, *_of_this_user()]
    if for_group() or _for_all():
        places += [RUNTIMES / "*" / "lfield", SHARED / "lfield-*"]
    return [str(place) for place in dict.fromkeys(places)]


def _group_of(path: Path) -> int:
    """The group of what is there; -1 where that cannot be seen."""
    try:
        return path.lstat().st_gid
    except OSError:
        return -1


def _by_user() -> dict[int, list[Path]]:
    """The folders that users have where all have theirs, by their owners: each counts in that name only."""
    found: dict[int, list[Path]] = defaultdict(list)
    if _for_all():
        for path in sorted(RUNTIMES.glob("*/lfield")):
            with suppress(OSError):
                if path.parent.name == str(path.lstat().st_uid):
                    found[path.lstat().st_uid].append(path)
    for shared in _temporary():
        with suppress(OSError):
            for user, paths in of_users(shared).items():
                found[user] += paths
    return found


# --- both ---------------------------------------------------------------------------------------------------


def _service() -> Path | None:
    """What systemd's `RuntimeDirectory=lfield` has made for this process."""
    folders = os.environ.get("RUNTIME_DIRECTORY", "").split(":")
    return next((Path(folder) for folder in folders if Path(folder).name == "lfield"), None)


def _runtime() -> Path | None:
    """The place in the runtime folder of this user, if there is one that nobody else may change."""
    runtime = runtime_folder()
    return None if runtime is None else runtime / "lfield"


def _temporary() -> list[Path]:
    """The temporary folders, best first; with LFIELD_RUNS=here none where there is a runtime folder."""
    if not _elsewhere():
        return [] if _runtime() is not None else [temporary_folder()]
    return list(dict.fromkeys((temporary_folder(), SHARED)))


def _of_this_user() -> list[Path]:
    """Where runs of this user can be, whatever the environment was that they were begun in."""
    user, runtime = os.geteuid(), _runtime()
    usual = [RUNTIMES / str(user) / "lfield"] if _elsewhere() else []
    shared = [folder / f"lfield-{user}" for folder in _temporary()]
    return list(dict.fromkeys([*([runtime] if runtime is not None else []), *usual, *shared]))


def _elsewhere() -> bool:
    """Whether more counts than the one place of this environment: not with LFIELD_RUNS=here."""
    return os.environ.get("LFIELD_RUNS", "") != "here"


def _for_all() -> bool:
    return os.geteuid() == ROOT and _elsewhere()
