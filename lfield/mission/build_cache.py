"""Build cache: a mission is compiled once and its bundle reused while its inputs are unchanged.

The cache is in the user's cache folder and accessible to that user only. A separate process builds the
bundle, so the process that runs it never loads the compiler. The key is the build request; a hit requires
that all inputs are unchanged, and the digests of the bundle are checked before use.
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
from pathlib import Path

import msgspec
from msgspec import Struct

from lfield import __version__, exit_status
from lfield.errors import BundleError, InputFileError, NoHomeFolder, OutputFileError
from lfield.mission import bundle
from lfield.mission.build_inputs import BuildInputs, module_search_paths
from lfield.text import user_dirs
from lfield.text.input_files import read_within
from lfield.text.secure_files import lock_private_folder, open_private_folder, private_folder

#: The newest bundles that the cache keeps.
MAX_BUNDLES = 64
#: A larger record is ignored.
_MAX_RECORD = 4 << 20
#: The prefix of temporary build folders, and the time-out for locking one, in seconds.
_BUILD_PREFIX, _LOCK_TIMEOUT = "building-", 60.0


class BuildFailed(Exception):
    """The build process reported errors; `status` is its exit status."""

    def __init__(self, status: int) -> None:
        self.status = status
        super().__init__(f"build failed (exit status {status})")


class BuildRequest(Struct, frozen=True):
    """Input of a build: a deployment with its files, or a bundle with other bindings.

    `as_json`: an error is also printed as a JSON object.
    """

    mission: Path
    program: Path | None = None
    devices: Path | None = None
    simulate: bool = False
    as_json: bool = False

    @property
    def build_arguments(self) -> list[str]:
        """The request as arguments of `lfield build`."""
        arguments = [str(self.mission)]
        for option, path in (("--program", self.program), ("--devices", self.devices)):
            if path is not None:
                arguments += [option, str(path)]
        return [*arguments, "--sim"] if self.simulate else arguments

    @property
    def key(self) -> str:
        """The cache key of this request; includes the working directory, interpreter and version."""
        identity = [__version__, sys.executable, os.getcwd(), module_search_paths(), self.build_arguments]
        return hashlib.sha256(repr(identity).encode()).hexdigest()[:32]


class _Record(msgspec.Struct, frozen=True, array_like=True):
    """Cache record: the digest of the bundle built for a request, and its inputs."""

    digest: bytes
    inputs: BuildInputs


_record = msgspec.msgpack.Decoder(_Record)
_inputs = msgspec.msgpack.Decoder(BuildInputs)


@contextmanager
def cached_bundle(request: BuildRequest) -> Iterator[Path]:
    """The bundle of a request, as a context manager; built now unless it is in the cache.

    Raises BuildFailed when its files have errors, which have been reported.
    """
    folder = cache_folder()
    if folder is not None:
        yield _find(folder, request) or _build_new(folder, request)
        return
    with tempfile.TemporaryDirectory(prefix=_BUILD_PREFIX) as workshop:
        yield _build(request, Path(workshop))


def cache_folder() -> Path | None:
    """The cache folder; None when there is no folder that only this user can access."""
    try:
        folder = private_folder(user_dirs.cache_dir() / "bundles")
        unseen = not folder.stat().st_mode & 0o077
    except (OSError, OutputFileError, NoHomeFolder):
        return None
    return folder if unseen and os.access(folder, os.W_OK | os.X_OK) else None


def _find(folder: Path, order: BuildRequest) -> Path | None:
    """The cached bundle of a request, if its inputs are unchanged."""
    try:
        record = _record.decode(read_within(folder / f"{order.key}.made", _MAX_RECORD))
        path = _place(folder, record.digest)
        is_valid = (
            record.inputs.is_up_to_date() and bundle.contents(bundle.read_file(path)).digest == record.digest
        )
    except (OSError, ValueError, msgspec.DecodeError, BundleError, InputFileError):
        return None
    return path if is_valid else None


def _build_new(folder: Path, order: BuildRequest) -> Path:
    """Build in a temporary folder inside the cache; it is removed even if the caller is killed later."""
    with (
        tempfile.TemporaryDirectory(prefix=_BUILD_PREFIX, dir=folder) as workshop,
        lock_private_folder(Path(workshop)),
    ):
        _build(order, Path(workshop))
        place = _store(folder, order, Path(workshop))
    _prune(folder)
    return place


def _build(order: BuildRequest, workshop: Path) -> Path:
    """Build in a separate process; writes the bundle and its `inputs`."""
    path = workshop / f"mission{bundle.SUFFIX}"
    options = ["-o", str(path), "--inputs", str(workshop / "inputs"), *(["--json"] if order.as_json else [])]
    command = [sys.executable, "-P", "-m", "lfield", "build", *order.build_arguments, *options]
    status = subprocess.run(command, stdin=subprocess.DEVNULL, check=False).returncode
    if status:
        raise BuildFailed(status if status > 0 else exit_status.SOFTWARE)
    return path


def _store(folder: Path, order: BuildRequest, workshop: Path) -> Path:
    """Move the bundle into the cache. The record is written last, which makes the entry valid."""
    path = workshop / f"mission{bundle.SUFFIX}"
    digest = bundle.contents(bundle.read_file(path)).digest
    record = _Record(digest, _inputs.decode((workshop / "inputs").read_bytes()))
    (workshop / "made").write_bytes(msgspec.msgpack.encode(record))
    os.replace(path, place := _place(folder, digest))
    os.replace(workshop / "made", folder / f"{order.key}.made")
    return place


def _place(folder: Path, digest: bytes) -> Path:
    return folder / f"{digest.hex()[:32]}{bundle.SUFFIX}"


def _prune(folder: Path) -> None:
    """Delete the oldest bundles, and temporary folders of killed builds."""
    for workshop in folder.glob(f"{_BUILD_PREFIX}*"):
        with suppress(OSError):
            if time.time() - workshop.stat().st_mtime > _LOCK_TIMEOUT:
                # A terminated process has released its lock.
                with open_private_folder(workshop) as opened:
                    fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(workshop)
    for pattern in (f"*{bundle.SUFFIX}", "*.made"):
        with suppress(OSError):
            oldest = sorted(folder.glob(pattern), key=lambda path: path.stat().st_mtime)[:-MAX_BUNDLES]
            for path in oldest:
                path.unlink(missing_ok=True)
