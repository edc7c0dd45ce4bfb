"""Registry of the runs on this computer: each `lfield up` has a private directory that commands find.

    <base>/<mission>-<8 hex digits>/
        note.json     the mission, its user and time of start, the addresses of its hosts (RunManifest)
        alpha.sock    the Unix socket of each host that runs here, for ps, query and estop

The bases are those of `run_dirs`; where one is open to a group, so are the run, its note and its sockets.

A run lives as long as a process holds the lock of its note. A process id can be reused; a lock ends with its
process. It is a write lock of an open file (F_OFD_SETLK), so a group that may only read the note cannot take
it. The next command of the user removes the directory of a killed run.

The note of another user is not trusted: it may claim any host of any mission, so it is kept separate.
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
from itertools import islice
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from lfield.driver.binding import longest_rest
from lfield.errors import OutputFileError
from lfield.mission.mission import Mission
from lfield.net.peer_credentials import GROUP
from lfield.net.transport import UNIX, has_zenoh
from lfield.net.zenoh.config import NETWORK, ZenohConfig
from lfield.operator.run_dirs import (
    RunLocation,
    SearchRoot,
    is_shared_with_group,
    run_locations,
    search_roots,
    searched_dirs,
    unreadable_hint,
)
from lfield.text.secure_files import (
    grant_group_read,
    new_private_folder,
    open_private_folder,
    read_private,
    write_private,
)
from lfield.text.suggestions import listed
from lfield.text.terminal_escape import printable_argument
from lfield.text.user_dirs import shared_runtime_dir
from lfield.wire.fields import MAX_LABEL, Name

#: Maximum length of the path of a Unix socket (bytes).
_MAX_SOCKET = 107
#: Maximum size of a note (bytes), also of all notes of another user together, and maximum number of that
#: user's files.
_MAX_MANIFEST, _MAX_FOREIGN = 4 << 20, 256
#: The most hosts that a team has.
_MAX_HOSTS = 4096
_MANIFEST = "note.json"
_ID = re.compile(r"[\w.+-]{1,24}-[0-9a-f]{8}", re.ASCII)
#: struct flock for a lock of a whole file: kind, start, length, owner.
_LOCK = struct.Struct("hhqqi")
#: A run directory under construction, and the time (s) after which it is considered abandoned.
_UNFINISHED, _UNFINISHED_FOR = re.compile(r"\.[0-9a-f]{16}"), 60.0


class RunManifest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The manifest of a run, in JSON.

    `mission` is the file it was started from and `deployment` the digest of its team, in hex; `started` is in
    seconds since 1970; every device must come to rest within `rest_within` seconds. `addresses` has the
    "address:port" of every host of the team, `control_sockets` the name of the socket of
    each that runs here. The owner is that of the file, and every socket is inside its folder. `zenoh` has the
    settings for addresses in a Zenoh fabric; None without such an address.
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
    control_sockets: Annotated[
        dict[Name, Annotated[str, Meta(pattern=r"^[A-Za-z0-9_+][A-Za-z0-9_.+-]{0,40}$")]],
        Meta(max_length=_MAX_HOSTS),
    ] = msgspec.field(name="doors")
    zenoh: ZenohConfig | None = None


class Run(Struct, frozen=True):
    """A run in its directory, which belongs to the user `owner`.

    `is_foreign`: the owner is neither the present user, nor root, nor a service. `named`: the user has named
    it.
    """

    folder: Path
    manifest: RunManifest
    owner: str = ""
    is_foreign: bool = False
    named: bool = False

    @property
    def id(self) -> str:
        """The id, also for `--run`: the name of its directory, with the owner for runs of other users."""
        return f"{self.owner}/{self.folder.name}" if self.is_foreign else self.folder.name

    @property
    def user(self) -> str:
        """The owner of a run of another user; '' for a trusted run, or one named by --run."""
        return self.owner if self.is_foreign and not self.named else ""

    def control_socket(self, host: str) -> str:
        """The control socket of a host; '' for a host that is not in this run."""
        name = self.manifest.control_sockets.get(host)
        return f"{UNIX}{self.folder / name}" if name else ""


# --- beginning one ------------------------------------------------------------------------------------------


class ControlSockets(Struct, frozen=True):
    """The control sockets of the hosts of a run by name, and the lock that marks the run as alive.

    Processes that inherit `lock` keep it alive too.
    """

    addresses: Mapping[str, str]
    lock: int


def run_manifest(mission: Mission, file: Path, hosts: Iterable[str]) -> RunManifest:
    """The manifest of a run of this process: some `hosts` of a mission from a file."""
    addresses = mission.team.addresses_by_host
    return RunManifest(
        mission=printable_argument(str(file.absolute())),
        deployment=mission.team.deployment.hex(),
        pid=os.getpid(),
        started=time.time(),
        rest_within=longest_rest(mission.bindings.all),
        addresses=addresses,
        control_sockets={host: _socket_name(number, host) for number, host in enumerate(hosts)},
        zenoh=NETWORK.config if any(map(has_zenoh, addresses.values())) else None,
    )


@contextmanager
def publish_run(manifest: RunManifest, report: Callable[[str], None]) -> Iterator[ControlSockets]:
    """Publish a run to commands on this computer; `report` prints the users who would not find it.

    Raises OutputFileError if no command would find it, or other users could change it.
    """
    run, lock = _create(manifest, report)
    try:
        yield ControlSockets({host: run.control_socket(host) for host in run.manifest.control_sockets}, lock)
    finally:
        _remove(run.folder)
        os.close(lock)


def _create(manifest: RunManifest, report: Callable[[str], None]) -> tuple[Run, int]:
    """Create the directory of a new run in the best place, with its lock."""
    first: OutputFileError | None = None
    for location in run_locations():
        try:
            run = _create_in(location, manifest)
        except OutputFileError as error:
            first = first or error
            continue
        if first is not None and is_shared_with_group() and location.group < 0:
            report(f"members of the group {GROUP} do not find this run: {first}")
        return run
    reason = first or OutputFileError(str(shared_runtime_dir().parent), "others could remove files in it")
    raise OutputFileError(
        reason.path,
        f"{reason.reason}; no command could find what runs, to stop it: set XDG_RUNTIME_DIR to another "
        "folder of your own, or remove what is in the way",
    )


def _create_in(location: RunLocation, manifest: RunManifest) -> tuple[Run, int]:
    """Create the directory of a new run with its lock, atomically."""
    base = location.path
    name = re.sub(r"[^A-Za-z0-9_.+-]", "_", Path(manifest.mission).stem)[:24].lstrip(".") or "run"
    run = Run(base / f"{name}-{secrets.token_hex(4)}", manifest)
    for host in run.manifest.control_sockets:
        if len(os.fsencode(run.control_socket(host))) > len(UNIX) + _MAX_SOCKET:
            raise OutputFileError(
                run.control_socket(host), "the path is too long for a socket; set XDG_RUNTIME_DIR"
            )
    _remove_abandoned(base)
    unfinished = base / f".{secrets.token_hex(8)}"
    new_private_folder(unfinished)
    lock = -1
    try:
        write_private(unfinished / _MANIFEST, msgspec.json.encode(run.manifest))
        lock = os.open(unfinished / _MANIFEST, os.O_RDWR | os.O_NOFOLLOW)
        fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, 0, 0, 0, 0))
        if location.group >= 0:
            # Not before it is locked: a user who may read it could lock it first.
            for path in (unfinished / _MANIFEST, unfinished, base):
                grant_group_read(path, location.group)
        os.rename(unfinished, run.folder)
    except (OSError, OutputFileError) as error:
        if lock >= 0:
            os.close(lock)
        _remove(unfinished)
        if isinstance(error, OSError):
            raise OutputFileError(str(run.folder), error.strerror or str(error)) from None
        raise
    return run, lock


def _socket_name(number: int, host: str) -> str:
    """The file name of a host's socket: its own name if possible."""
    fits = re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,30}", host)
    return f"{host}.sock" if fits else f"+{number}.sock"


def _name_of(user: int) -> str:
    try:
        return pwd.getpwuid(user).pw_name
    except KeyError:
        return str(user)


# --- finding them -------------------------------------------------------------------------------------------


def runs_here() -> list[Run]:
    """All live runs that this user may see, the oldest first; those of other users last."""
    found = [run for base in search_roots() for run in _runs_in(base)]
    return sorted(found, key=lambda run: (run.is_foreign, run.manifest.started, run.id))


def no_runs_hint() -> str:
    """The searched directories, and the remedy for runs that are elsewhere."""
    hidden = unreadable_hint()
    return (
        f"searched {listed(searched_dirs())}; if a mission was started with another XDG_RUNTIME_DIR, set "
        f"this variable to the same value{f'; {hidden}' if hidden else ''}"
    )


def _runs_in(base: SearchRoot) -> Iterator[Run]:
    remaining, limit = _MAX_MANIFEST, _MAX_FOREIGN if base.is_foreign else None
    if os.geteuid() in base.owners:
        for path in base.paths:
            _remove_abandoned(path)
    names = ((path, name) for path in base.paths for name in _names_in(path, base.owners, limit))
    for path, name in islice(names, limit):
        folder = path / name
        if not (_ID.fullmatch(name) and _is_locked(folder)):
            continue
        with suppress(OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            data = read_private(folder / _MANIFEST, remaining, base.owners)
            remaining -= len(data) if base.is_foreign else 0
            owner = _name_of(folder.lstat().st_uid)
            yield Run(folder, msgspec.json.decode(data, type=RunManifest), owner, base.is_foreign)


def _names_in(base: Path, owners: Collection[int], limit: int | None = None) -> list[str]:
    try:
        with open_private_folder(base, owners) as folder, os.scandir(folder) as found:
            return sorted(entry.name for entry in islice(found, limit))
    except OSError:
        return []


def _is_locked(folder: Path, *, unsure: bool = False) -> bool:
    """Whether a process of the run in that directory is alive: one that may write its manifest.

    Returns `unsure` if that cannot be determined.
    """
    try:
        # The file may be a FIFO, whose open would block until a writer opens it.
        note = os.open(folder / _MANIFEST, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    except OSError:
        return unsure
    try:
        query = _LOCK.pack(fcntl.F_RDLCK, 0, 0, 0, 0)
        kind, *_ = _LOCK.unpack(fcntl.fcntl(note, fcntl.F_OFD_GETLK, query))
        return bool(kind != fcntl.F_UNLCK)
    except OSError:
        return unsure
    finally:
        os.close(note)


def _remove_abandoned(base: Path) -> None:
    """Remove the directories of killed runs of this user."""
    for name in _names_in(base, ()):
        folder = base / name
        if _is_abandoned(folder, name) and not _is_locked(folder, unsure=True):
            _remove(folder)


def _is_abandoned(folder: Path, name: str) -> bool:
    """Whether a directory is that of an abandoned run; one that is being created is not locked at first."""
    if _ID.fullmatch(name):
        return True
    try:
        return bool(_UNFINISHED.fullmatch(name)) and time.time() - folder.stat().st_mtime > _UNFINISHED_FOR
    except OSError:
        return False


def _remove(folder: Path) -> None:
    """Remove a directory of this user; another process may remove it at the same time."""
    with suppress(OSError), open_private_folder(folder) as opened:
        for name in os.listdir(opened):
            with suppress(FileNotFoundError):
                os.unlink(name, dir_fd=opened)
        folder.rmdir()
