"""The team of a mission, and where its hosts listen on this machine, for commands started later.

`up --all` takes free ports; it leaves a small file that `ps` finds by the deployment's hash. The file names
the process that wrote it, and is believed only while that process lives.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from lfield.errors import OutputFileError
from lfield.lang.deployment import read_deployment
from lfield.mission import bundle
from lfield.mission.team import Team, team_of
from lfield.text.private import read_private, write_private
from lfield.wire.messages import Label, Name

#: A larger note is none.
_MAX_NOTE = 4 << 20


def open_team(mission: Path) -> Team:
    """The team of a bundle, or of a deployment, whose program is not looked at: no kinds are known then.

    Raises InputFileError, and BundleError or ProgramError for a file with mistakes.
    """
    if mission.suffix == bundle.SUFFIX:
        return bundle.read(mission).team
    deployment = read_deployment(mission, None)
    return team_of(deployment.rows, deployment.kinds, deployment.ports)


class Note(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the file says, in JSON: who wrote it, and for each host its "address:port"."""

    pid: Annotated[int, Meta(gt=0, lt=2**31)]
    addresses: Annotated[dict[Name, Label], Meta(max_length=4096)]


def _path(deployment: bytes) -> Path:
    base = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return Path(base) / f"lfield-{os.getuid()}" / f"{deployment.hex()[:32]}.json"


@contextmanager
def published(deployment: bytes, addresses: Mapping[str, str], tell: Callable[[str], None]) -> Iterator[None]:
    """Let others on this machine find these addresses (host name to "host:port") for the duration.

    Where that cannot be, or others could change the note, nothing is published; `tell` hears why.
    """
    path, note = _path(deployment), Note(os.getpid(), dict(addresses))
    try:
        write_private(path, msgspec.json.encode(note))
    except OutputFileError as error:
        tell(f"ps, query and estop need --map to find these hosts: {error}")
    try:
        yield
    finally:
        # The same deployment may have been started twice: the later one's note is not ours to take.
        if _read(path) == note:
            with suppress(OSError):
                path.unlink()


def find(deployment: bytes) -> dict[str, str]:
    """The addresses published for a deployment, {} when nobody who lives has published any."""
    note = _read(_path(deployment))
    if note is None:
        return {}
    try:
        os.kill(note.pid, 0)
    except OSError:
        return {}
    return note.addresses


def _read(path: Path) -> Note | None:
    """The note, None when there is none that makes sense in a folder of this user."""
    try:
        return msgspec.json.decode(read_private(path, _MAX_NOTE), type=Note)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
