"""What runs on this computer: each `lfield up` has a private folder of its own, which commands find.

    <base>/<mission>-<8 hex digits>/
        note.json     what runs: the mission, who started it and when, where its hosts are (Note)
        alpha.sock    the Unix socket of each host that runs here, for ps, query and estop

The base is `/run/lfield` where a service manager has made that, then readable by its group; else `lfield` in
the user's runtime folder, or one in the temporary folder. A run lives as long as a process of it holds the
lock of its note: a number of a process may be another's tomorrow, a lock goes with whoever held it. It is one
for writing, and of an open file (F_OFD_SETLK): who may only read the note, as a group, cannot take it.
What is left of a run that was killed is tidied up by the next command of its user.

Who looks may have another environment than who started (sudo, su, cron): all folders are looked into that the
user's runs can be in without anybody having named another, and root looks into those of all users. What a
note of another user says is that user's word: it may claim any host of any mission, so it is kept apart.
"""

from __future__ import annotations

import fcntl
import os
import pwd
import re
import secrets
import struct
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from lfield.driver.binding import longest_rest
from lfield.errors import OutputFileError
from lfield.mission.mission import Mission
from lfield.net.stream import UNIX
from lfield.text.private import (
    new_private_folder,
    private_opened,
    read_private,
    temporary_folder,
    write_private,
)
from lfield.text.suggest import listed
from lfield.wire.fields import MAX_LABEL, Name

#: Where the unit of deploy/ has its runs.
SERVICE = Path("/run/lfield")
#: Where systemd has the runtime folders of users, by number, and where temporary files usually are.
RUNTIMES, SHARED = Path("/run/user"), Path("/tmp")
#: So long the path of a Unix socket may be, in bytes.
_MAX_SOCKET = 107
#: A larger note is none; those of another user count as one, and so many of that user's files are looked at.
_MAX_NOTE, _MOST_OF_OTHERS = 4 << 20, 256
#: The most hosts that a team has.
_MAX_HOSTS = 4096
_NOTE = "note.json"
_ID = re.compile(r"[\w.+-]{1,24}-[0-9a-f]{8}", re.ASCII)
#: A lock of all of a file, as the kernel is asked for it: its kind, where it begins and ends, and whose.
_LOCK = struct.Struct("hhqqi")
#: A run that is being made; nobody takes so many seconds for it.
_UNFINISHED, _UNFINISHED_FOR = re.compile(r"\.[0-9a-f]{16}"), 60.0


class Note(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a run says of itself, in JSON.

    `mission` is the file it was started from and `deployment` the digest of its team, in hex; `started` is in
    seconds since 1970; of its devices none has longer than `rest_within` seconds to come to rest. `addresses`
    has the "address:port" of every host of the team, `doors` the name of the socket of those that run here.
    Whose it is, its file says, and no socket is outside its folder.
    """

    mission: Annotated[str, Meta(max_length=4096)]
    deployment: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]
    pid: Annotated[int, Meta(gt=0, lt=2**31)]
    started: Annotated[float, Meta(ge=0.0, le=1e11)]
    rest_within: Annotated[float, Meta(ge=0.0, le=1e6)]
    addresses: Annotated[
        dict[Name, Annotated[str, Meta(max_length=MAX_LABEL, pattern=r"^(?!unix:|fd:)")]],
        Meta(max_length=_MAX_HOSTS),
    ]
    doors: Annotated[
        dict[Name, Annotated[str, Meta(pattern=r"^[A-Za-z0-9_+][A-Za-z0-9_.+-]{0,40}$")]],
        Meta(max_length=_MAX_HOSTS),
    ]


@dataclass(frozen=True, slots=True)
class Run:
    """A run that somebody has begun, in its folder, which belongs to the user `owner`.

    It `is_foreign` where that is neither who looks, nor root, nor a service. Who looks may have `named` it.
    """

    folder: Path
    note: Note
    owner: str = ""
    is_foreign: bool = False
    named: bool = False

    @property
    def id(self) -> str:
        """What it is called, here and by `--run`: as its folder. No user has the names of another."""
        return f"{self.owner}/{self.folder.name}" if self.is_foreign else self.folder.name

    @property
    def user(self) -> str:
        """The other user whose word it is that there is such a run; '' where it is believed, or was named."""
        return self.owner if self.is_foreign and not self.named else ""

    def door(self, host: str) -> str:
        """The address of a host of the team for commands here, '' for one that this run does not run."""
        name = self.note.doors.get(host)
        return f"{UNIX}{self.folder / name}" if name else ""


# --- beginning one ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Doors:
    """Where the hosts of a run listen for commands, by name, and the open lock that keeps the run alive.

    Processes that inherit `lock` keep it alive too. Both are empty where no command finds the run.
    """

    addresses: Mapping[str, str]
    lock: tuple[int, ...] = ()


def begun(mission: Mission, file: Path, here: Iterable[str]) -> Note:
    """What a run tells of itself that this process begins: the hosts `here` of a mission from a file."""
    return Note(
        mission=str(file.absolute()),
        deployment=mission.team.deployment.hex(),
        pid=os.getpid(),
        started=time.time(),
        rest_within=longest_rest(mission.bindings.all),
        addresses=mission.team.reached,
        doors={host: _door_name(number, host) for number, host in enumerate(here)},
    )


@contextmanager
def running(note: Note, unfound: Callable[[OutputFileError], None]) -> Iterator[Doors]:
    """Let commands on this computer find a run for the duration.

    Where that cannot be, or others could change what is said of it, `unfound` hears why: it goes on unfound,
    unless that raises (see `refuse_unfound`).
    """
    try:
        run, lock = _begin(note)
    except OutputFileError as error:
        unfound(error)
        yield Doors({})
        return
    try:
        yield Doors({host: run.door(host) for host in run.note.doors}, (lock,))
    finally:
        _remove(run.folder)
        os.close(lock)


def refuse_unfound(error: OutputFileError) -> None:
    """For hosts that no other computer can reach either: nobody could stop them. Raises OutputFileError."""
    raise OutputFileError(
        error.path,
        f"{error.reason}; no command could find what runs, to stop it: set XDG_RUNTIME_DIR to another folder "
        "of your own, or remove what is in the way",
    ) from None


def _begin(note: Note) -> tuple[Run, int]:
    """The folder of a new run, and its lock. It appears to others whole and locked, or not at all."""
    base, for_group = _base()
    _tidy(base)
    name = re.sub(r"[^A-Za-z0-9_.+-]", "_", Path(note.mission).stem)[:24].lstrip(".") or "run"
    run = Run(base / f"{name}-{secrets.token_hex(4)}", note)
    for door in run.note.doors:
        if len(os.fsencode(run.door(door))) > len(UNIX) + _MAX_SOCKET:
            raise OutputFileError(run.door(door), "the path is too long for a socket; set XDG_RUNTIME_DIR")
    unfinished = base / f".{secrets.token_hex(8)}"
    os.close(new_private_folder(unfinished, 0o750 if for_group else 0o700))
    lock = -1
    try:
        write_private(unfinished / _NOTE, msgspec.json.encode(run.note), 0o640 if for_group else 0o600)
        lock = os.open(unfinished / _NOTE, os.O_RDWR | os.O_NOFOLLOW)
        fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, 0, 0, 0, 0))
        os.rename(unfinished, run.folder)
    except (OSError, OutputFileError) as error:
        if lock >= 0:
            os.close(lock)
        _remove(unfinished)
        if isinstance(error, OSError):
            raise OutputFileError(str(run.folder), error.strerror or str(error)) from None
        raise
    return run, lock


def _door_name(number: int, host: str) -> str:
    """The name of a host's socket: its own where that will do for a file."""
    fits = re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,30}", host)
    return f"{host}.sock" if fits else f"+{number}.sock"


def _name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


# --- finding them -------------------------------------------------------------------------------------------


def runs_here() -> list[Run]:
    """All runs on this computer that live and that this user may see, the oldest first; foreign ones last."""
    found = [run for base in _bases() for run in _runs_in(base)]
    return sorted(found, key=lambda run: (run.is_foreign, run.note.started, run.id))


def unseen() -> str:
    """What to do for a service's runs that this user may not see; '' when there can be none."""
    service = _service() or SERVICE
    if not service.exists() or os.access(service, os.R_OK | os.X_OK):
        return ""
    return f"what runs in {service} this user may not see: use sudo, or join the group of that folder"


def nothing_here() -> str:
    """Where a command has looked in vain, and what to do for runs that are elsewhere."""
    service = _service() or SERVICE
    places = [service, *_of_user()]
    if _for_all():
        places += [RUNTIMES / "*" / "lfield", SHARED / "lfield-*"]
    looked = listed([str(place) for place in dict.fromkeys(places)])
    hidden = unseen()
    return (
        f"looked into {looked}; a run that was started with another TMPDIR or XDG_RUNTIME_DIR is found "
        f"with that set the same{f'; {hidden}' if hidden else ''}"
    )


def _runs_in(base: _Base) -> Iterator[Run]:
    if os.geteuid() in base.owners:
        _tidy(base.path)
    left = _MAX_NOTE
    for name in _names_in(base.path, base.owners, _MOST_OF_OTHERS if base.is_foreign else None):
        folder = base.path / name
        if not (_ID.fullmatch(name) and _is_locked(folder)):
            continue
        with suppress(OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            data = read_private(folder / _NOTE, left, base.owners)
            left -= len(data) if base.is_foreign else 0
            owner = _name_of(folder.lstat().st_uid)
            yield Run(folder, msgspec.json.decode(data, type=Note), owner, base.is_foreign)


def _names_in(base: Path, owners: Collection[int], most: int | None = None) -> list[str]:
    try:
        with private_opened(base, owners) as folder, os.scandir(folder) as found:
            return sorted(entry.name for entry in islice(found, most))
    except OSError:
        return []


def _is_locked(folder: Path, *, unsure: bool = False) -> bool:
    """Whether a process lives that belongs to the run with that folder: one that may write its note.

    `unsure` where that cannot be seen.
    """
    try:
        # What is there may be a fifo, and not be opened before somebody writes.
        note = os.open(folder / _NOTE, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    except OSError:
        return unsure
    try:
        asked = _LOCK.pack(fcntl.F_RDLCK, 0, 0, 0, 0)
        kind, *_ = _LOCK.unpack(fcntl.fcntl(note, fcntl.F_OFD_GETLK, asked))
        return bool(kind != fcntl.F_UNLCK)
    except OSError:
        return unsure
    finally:
        os.close(note)


def _tidy(base: Path) -> None:
    """Remove what is left in a folder of this user of runs that were killed."""
    for name in _names_in(base, ()):
        folder = base / name
        if _is_abandoned(folder, name) and not _is_locked(folder, unsure=True):
            _remove(folder)


def _is_abandoned(folder: Path, name: str) -> bool:
    """Whether what is there was a run, unless it is locked. One that is being made is not locked at first."""
    if _ID.fullmatch(name):
        return True
    try:
        return bool(_UNFINISHED.fullmatch(name)) and time.time() - folder.stat().st_mtime > _UNFINISHED_FOR
    except OSError:
        return False


def _remove(folder: Path) -> None:
    """Remove a folder of this user with the files in it. Another process may be at it, too."""
    with suppress(OSError), private_opened(folder) as opened:
        for name in os.listdir(opened):
            with suppress(FileNotFoundError):
                os.unlink(name, dir_fd=opened)
        folder.rmdir()


# --- where --------------------------------------------------------------------------------------------------


def _base() -> tuple[Path, bool]:
    """Where this process has its run, and whether its group may see that: in a service's folder."""
    service = _service()
    if service is not None and service.is_dir():
        return service, True
    return _own()[0], False


class _Base(NamedTuple):
    """Where runs can be, and the users whose they can be there; `is_foreign` as of a run."""

    path: Path
    owners: Collection[int]
    is_foreign: bool = False


def _bases() -> Iterator[_Base]:
    service = _service() or SERVICE
    # Where only root may write, the service manager has made it: whoever it belongs to is the service.
    with suppress(OSError), private_opened(service.parent, (0, os.geteuid())):
        yield _Base(service, {0, service.lstat().st_uid})
    own = _of_user()
    yield from (_Base(base, {os.geteuid()}) for base in own if base != service)
    if _for_all():
        for base, owner in _of_others():
            if base not in (service, *own):
                yield _Base(base, {owner}, is_foreign=owner != os.geteuid())


def _service() -> Path | None:
    """What systemd's `RuntimeDirectory=lfield` has made for this process."""
    folders = os.environ.get("RUNTIME_DIRECTORY", "").split(":")
    return next((Path(folder) for folder in folders if Path(folder).name == "lfield"), None)


def _own() -> list[Path]:
    """The folders of this user for this, the best first."""
    temporary = temporary_folder() / f"lfield-{os.geteuid()}"
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    with suppress(OSError):
        # After `su` it may still be another user's.
        if runtime and os.stat(runtime).st_uid == os.geteuid():
            return [Path(runtime) / "lfield", temporary]
    return [temporary]


def _elsewhere() -> bool:
    """Whether commands look where runs of another environment can be: not with LFIELD_RUNS=here."""
    return os.environ.get("LFIELD_RUNS", "") != "here"


def _for_all() -> bool:
    return os.geteuid() == 0 and _elsewhere()


def _of_user() -> list[Path]:
    """Where runs of this user can be, whatever the environment was that they were started in."""
    if not _elsewhere():
        return _own()[:1]
    user = str(os.geteuid())
    usual = [RUNTIMES / user / "lfield", SHARED / f"lfield-{user}"]
    return list(dict.fromkeys([*_own(), temporary_folder() / f"lfield-{user}", *usual]))


def _of_others() -> Iterator[tuple[Path, int]]:
    """The folders of all users, each with its owner: it counts only in the name of that user."""
    for base in sorted([*RUNTIMES.glob("*/lfield"), *SHARED.glob("lfield-*")]):
        name = base.parent.name if base.name == "lfield" else base.name.removeprefix("lfield-")
        with suppress(OSError):
            owner = base.lstat().st_uid
            if name == str(owner):
                yield base, owner
