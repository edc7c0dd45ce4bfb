"""Bundles that were built on this computer before: a mission is compiled once, however often it is started.

They lie in the user's cache folder, which must be the user's alone. A bundle is built in a process of its
own, so that the one that runs it never loads the compiler. It is found by what was asked for, is believed
while all it was made of is unchanged, and its digests are checked before it is used.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from lfield import __version__, exits
from lfield.errors import BundleError, InputFileError, NoHome, OutputFileError
from lfield.mission import bundle
from lfield.mission.inputs import Inputs, searched
from lfield.text import own_folders
from lfield.text.files import read_within
from lfield.text.private import private_folder, private_locked, private_opened

#: So many bundles are kept, the last that were made.
KEPT = 64
#: A larger record is none.
_MAX_RECORD = 4 << 20
#: What the folders of builds under way are called, and after how many seconds they are locked for certain.
_WORKSHOP, _LOCKED_BY = "building-", 60.0


class NotBuilt(Exception):
    """The process that builds has told what is wrong; `status` is what it ended with."""

    def __init__(self, status: int) -> None:
        self.status = status
        super().__init__(f"the bundle was not built (status {status})")


@dataclass(frozen=True, slots=True)
class Order:
    """What is to be built: a deployment with its files, or a bundle with other bindings."""

    mission: Path
    program: Path | None = None
    devices: Path | None = None
    simulate: bool = False

    @property
    def words(self) -> list[str]:
        """The same as words for `lfield build`."""
        words = [str(self.mission)]
        for option, path in (("--program", self.program), ("--devices", self.devices)):
            if path is not None:
                words += [option, str(path)]
        return [*words, "--sim"] if self.simulate else words

    @property
    def key(self) -> str:
        """What tells this order from others: also where it is given, and by whom it is carried out."""
        said = [__version__, sys.executable, os.getcwd(), searched(), self.words]
        return hashlib.sha256(repr(said).encode()).hexdigest()[:32]


class _Record(msgspec.Struct, frozen=True, array_like=True):
    """The bundle that an order led to, by its digest, and what it was made of."""

    digest: bytes
    inputs: Inputs


_record = msgspec.msgpack.Decoder(_Record)
_inputs = msgspec.msgpack.Decoder(Inputs)


@contextmanager
def prepared(order: Order) -> Iterator[Path]:
    """The bundle of an order, for the duration; built now unless it was before.

    Raises NotBuilt when its files have mistakes, which have been told then.
    """
    folder = cache_folder()
    if folder is not None:
        yield _kept(folder, order) or _made(folder, order)
        return
    with tempfile.TemporaryDirectory(prefix=_WORKSHOP) as workshop:
        yield _build(order, Path(workshop))


def cache_folder() -> Path | None:
    """Where bundles are kept; None when there is no folder that is this user's alone."""
    try:
        folder = private_folder(own_folders.cache_folder() / "bundles")
        unseen = not folder.stat().st_mode & 0o077
    except (OSError, OutputFileError, NoHome):
        return None
    return folder if unseen and os.access(folder, os.W_OK | os.X_OK) else None


def _kept(folder: Path, order: Order) -> Path | None:
    """The bundle that the order led to before, if it still would."""
    try:
        record = _record.decode(read_within(folder / f"{order.key}.made", _MAX_RECORD))
        path = _place(folder, record.digest)
        sound = record.inputs.unchanged() and bundle.contents(bundle.read_file(path)).digest == record.digest
    except (OSError, ValueError, msgspec.DecodeError, BundleError, InputFileError):
        return None
    return path if sound else None


def _made(folder: Path, order: Order) -> Path:
    """Build in the cache, and leave nothing else there: whoever runs the bundle may be killed."""
    with (
        tempfile.TemporaryDirectory(prefix=_WORKSHOP, dir=folder) as workshop,
        private_locked(Path(workshop)),
    ):
        _build(order, Path(workshop))
        place = _keep(folder, order, Path(workshop))
    _prune(folder)
    return place


def _build(order: Order, workshop: Path) -> Path:
    """Build in a process of its own; the bundle, beside it `inputs`."""
    made = workshop / f"mission{bundle.SUFFIX}"
    options = ["-o", str(made), "--inputs", str(workshop / "inputs")]
    command = [sys.executable, "-P", "-m", "lfield", "build", *order.words, *options]
    status = subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode
    if status:
        raise NotBuilt(status if status > 0 else exits.SOFTWARE)
    return made


def _keep(folder: Path, order: Order, workshop: Path) -> Path:
    """Put what was built where it is found next time. The record comes last: it is what makes it count."""
    made = workshop / f"mission{bundle.SUFFIX}"
    digest = bundle.contents(bundle.read_file(made)).digest
    record = _Record(digest, _inputs.decode((workshop / "inputs").read_bytes()))
    (workshop / "made").write_bytes(msgspec.msgpack.encode(record))
    os.replace(made, place := _place(folder, digest))
    os.replace(workshop / "made", folder / f"{order.key}.made")
    return place


def _place(folder: Path, digest: bytes) -> Path:
    return folder / f"{digest.hex()[:32]}{bundle.SUFFIX}"


def _prune(folder: Path) -> None:
    """Forget what was made longest ago, and what a build that was killed has left."""
    for workshop in folder.glob(f"{_WORKSHOP}*"):
        with suppress(OSError):
            if time.time() - workshop.stat().st_mtime > _LOCKED_BY:
                # The lock of a process that is no more has gone with it.
                with private_opened(workshop) as opened:
                    fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(workshop)
    for pattern in (f"*{bundle.SUFFIX}", "*.made"):
        with suppress(OSError):
            oldest = sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime)[:-KEPT]
            for path in oldest:
                path.unlink(missing_ok=True)
