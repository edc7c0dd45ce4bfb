"""What runs on this computer: each `lfield up` has a private folder of its own, which commands find.

    <base>/<mission>-<8 hex digits>/
        note.json     what runs: the mission, who started it and when, where its hosts are (Note)
        alpha.sock    the Unix socket of each host that runs here, for ps, query and estop

The bases are in `places`; where one is open to a group, so are the run, its note and its sockets. A run lives
as long as a process of it holds the lock of its note: a number of a process may be another's tomorrow, a lock
goes with whoever held it. It is one for writing, and of an open file (F_OFD_SETLK): who may only read the
note, as a group, cannot take it. What is left of a run that was killed is tidied up by the next command of
its user.

What a note of another user says is that user's word: it may claim any host of any mission, so it is kept
apart.
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
from typing import Annotated

import msgspec
from msgspec import Meta

from lfield.driver.binding import longest_rest
from lfield.errors import OutputFileError
from lfield.mission.mission import Mission
from lfield.net.door import GROUP
from lfield.net.transport import UNIX
from lfield.operator.places import Base, Spot, bases, for_group, looked_into, spots, unseen
from lfield.text.private import (
    let_read,
    new_private_folder,
    private_opened,
    read_private,
    temporary_folder,
    write_private,
)
from lfield.text.suggest import listed
from lfield.text.visible import as_text
from lfield.wire.fields import MAX_LABEL, Name

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

    Processes that inherit `lock` keep it alive too.
    """

    addresses: Mapping[str, str]
    lock: int


def begun(mission: Mission, file: Path, here: Iterable[str]) -> Note:
    """What a run tells of itself that this process begins: the hosts `here` of a mission from a file."""
    return Note(
        mission=as_text(str(file.absolute())),
        deployment=mission.team.deployment.hex(),
        pid=os.getpid(),
        started=time.time(),
        rest_within=longest_rest(mission.bindings.all),
        addresses=mission.team.reached,
        doors={host: _door_name(number, host) for number, host in enumerate(here)},
    )


@contextmanager
def running(note: Note, tell: Callable[[str], None]) -> Iterator[Doors]:
    """Let commands on this computer find a run for the duration; `tell` hears who does not, and should.

    Raises OutputFileError where no command would: nobody could stop it, or others say what it is.
    """
    run, lock = _begin(note, tell)
    try:
        yield Doors({host: run.door(host) for host in run.note.doors}, lock)
    finally:
        _remove(run.folder)
        os.close(lock)


def _begin(note: Note, tell: Callable[[str], None]) -> tuple[Run, int]:
    """The folder of a new run, in the best place that can be had, and its lock."""
    first: OutputFileError | None = None
    for spot in spots():
        try:
            begun = _begin_in(spot, note)
        except OutputFileError as error:
            first = first or error
            continue
        if first is not None and for_group() and spot.group < 0:
            tell(f"members of the group {GROUP} do not find this run: {first}")
        return begun
    reason = first or OutputFileError(str(temporary_folder()), "others could remove what is in it")
    raise OutputFileError(
        reason.path,
        f"{reason.reason}; no command could find what runs, to stop it: set XDG_RUNTIME_DIR to another "
        "folder of your own, or remove what is in the way",
    )


def _begin_in(spot: Spot, note: Note) -> tuple[Run, int]:
    """The folder of a new run, and its lock. It appears to others whole and locked, or not at all."""
    base = spot.path
    name = re.sub(r"[^A-Za-z0-9_.+-]", "_", Path(note.mission).stem)[:24].lstrip(".") or "run"
    run = Run(base / f"{name}-{secrets.token_hex(4)}", note)
    for door in run.note.doors:
        if len(os.fsencode(run.door(door))) > len(UNIX) + _MAX_SOCKET:
            raise OutputFileError(run.door(door), "the path is too long for a socket; set XDG_RUNTIME_DIR")
    _tidy(base)
    unfinished = base / f".{secrets.token_hex(8)}"
    new_private_folder(unfinished)
    lock = -1
    try:
        write_private(unfinished / _NOTE, msgspec.json.encode(run.note))
        lock = os.open(unfinished / _NOTE, os.O_RDWR | os.O_NOFOLLOW)
        fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, 0, 0, 0, 0))
        if spot.group >= 0:
            # Not before it is locked: who may read it could lock it first.
            for path in (unfinished / _NOTE, unfinished, base):
                let_read(path, spot.group)
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
    found = [run for base in bases() for run in _runs_in(base)]
    return sorted(found, key=lambda run: (run.is_foreign, run.note.started, run.id))


def nothing_here() -> str:
    """Where a command has looked in vain, and what to do for runs that are elsewhere."""
    hidden = unseen()
    return (
        f"looked into {listed(looked_into())}; a run that was started with another TMPDIR or XDG_RUNTIME_DIR "
        f"is found with that set the same{f'; {hidden}' if hidden else ''}"
    )


def _runs_in(base: Base) -> Iterator[Run]:
    left, most = _MAX_NOTE, _MOST_OF_OTHERS if base.is_foreign else None
    if os.geteuid() in base.owners:
        for path in base.paths:
            _tidy(path)
    names = ((path, name) for path in base.paths for name in _names_in(path, base.owners, most))
    for path, name in islice(names, most):
        folder = path / name
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
