"""The disk of a service: bundles, pieces under way, and the state.

    <state>/service/state.json       ServiceRecord, replaced atomically
    <state>/service/bundles/<digest>.lfm
    <state>/service/staging/<file>/  pieces of a bundle that is arriving, by number, and its offer

A file is on disk before a method returns. Raises OutputFileError if it cannot be written.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from lfield.errors import DamagedFileError, InputFileError, OutputFileError
from lfield.mission.bundle import SUFFIX
from lfield.service.ballots import ActivationState
from lfield.text.secure_files import private_folder, read_private, write_private
from lfield.wire.bundle_pieces import Piece, piece_of, split
from lfield.wire.fields import Hash, OptionalOrderId, Text

#: The largest state file, in bytes, and free space that a piece must leave.
MAX_STATE, RESERVE = 4 << 20, 16 << 20
#: Bytes that are kept for the state on a full disk.
STATE_RESERVE = 256 << 10
#: Bundles that are kept beside the active and the previous one, and uploads that are kept unfinished.
KEPT_BUNDLES, KEPT_UPLOADS = 3, 2


class RunRecord(Struct, frozen=True):
    """The mission's host that should run: its bundle, and the boot of the computer in which it was started.

    `bundle` is b"" when no host should run. `pid` and `started` (clock ticks after the boot) identify the
    process, 0 before it was started. `unsafe` is the reason why the vehicles of the last host may not be at
    rest. `open_run` is the bundle that was started last, until its run has ended or was discarded: its
    coordinators may exist on any host of its mission. `order` is the id of the order that started it.
    """

    bundle: Hash = b""
    boot: str = ""
    pid: Annotated[int, Meta(ge=0)] = 0
    started: Annotated[int, Meta(ge=0)] = 0
    unsafe: Text = ""
    open_run: Hash = b""
    order: OptionalOrderId = b""


class ServiceRecord(Struct, frozen=True):
    """The durable state of a service. `held`: the service may hold the mission's host for a ballot."""

    activation: ActivationState = ActivationState()
    run: RunRecord = RunRecord()
    held: bool = False


#: The names of bundles and of uploads. Other programs may put files there.
_DIGEST = re.compile("[0-9a-f]{64}")
_encoder, _decoder = msgspec.json.Encoder(), msgspec.json.Decoder(ServiceRecord)


class BundleStore:
    """The files of one service in `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder = private_folder(folder)
        self._reserve = folder / "reserve"
        self._bundles = private_folder(folder / "bundles")
        self._staging = private_folder(folder / "staging")
        #: The numbers of stored pieces of uploads, by file.
        self._arrived: dict[bytes, set[int]] = {}
        #: The place of each piece in stored bundles: path, offset.
        self._known: dict[bytes, tuple[Path, int]] = {}
        self._indexed: set[Path] = set()

    # --- state ----------------------------------------------------------------------------------------

    def load(self) -> ServiceRecord:
        """The stored state, a new one if there is none. Raises DamagedFileError, InputFileError."""
        path = self._folder / "state.json"
        try:
            return _decoder.decode(read_private(path, MAX_STATE))
        except FileNotFoundError:
            return ServiceRecord()
        except msgspec.MsgspecError as error:
            reason = (
                f"not the state of a service: {error}; restore it from a backup, or rename it and repeat "
                "'lfield push': without it no bundle is active here, and the votes of this host are forgotten"
            )
            raise DamagedFileError(str(path), reason) from None
        except OSError as error:
            raise InputFileError(str(path), error.strerror or str(error)) from None

    def save(self, record: ServiceRecord) -> None:
        """Replace the state. On a full disk the reserve makes room, so that a vote can be stored."""
        path, data = self._folder / "state.json", _encoder.encode(record)
        try:
            write_private(path, data, durable=True)
        except OutputFileError:
            self._reserve.unlink(missing_ok=True)
            write_private(path, data, durable=True)
            return
        if not self._reserve.exists():
            with suppress(OutputFileError):
                write_private(self._reserve, bytes(STATE_RESERVE))

    # --- bundles --------------------------------------------------------------------------------------

    def path(self, digest: bytes) -> Path:
        """The file of a bundle, which need not exist."""
        return self._bundles / f"{digest.hex()}{SUFFIX}"

    def stored(self) -> list[bytes]:
        """The digests of the stored bundles, the newest first."""
        found = sorted(self._bundles.glob(f"*{SUFFIX}"), key=lambda file: file.stat().st_mtime, reverse=True)
        return [bytes.fromhex(file.stem) for file in found if _DIGEST.fullmatch(file.stem)]

    def read(self, digest: bytes) -> bytes | None:
        """The bytes of a stored bundle, None without one."""
        with suppress(OSError):
            return self.path(digest).read_bytes()
        return None

    def require(self, digest: bytes) -> bytes:
        """The bytes of a stored bundle. Raises InputFileError without one."""
        if (data := self.read(digest)) is None:
            raise InputFileError(str(self.path(digest)), "it was deleted")
        return data

    def add(self, digest: bytes, data: bytes, protected: Collection[bytes]) -> None:
        """Store a bundle, and remove the oldest others that are not `protected`."""
        write_private(self.path(digest), data, durable=True)
        others = [each for each in self.stored() if each not in protected and each != digest]
        for old in others[KEPT_BUNDLES:]:
            self.path(old).unlink(missing_ok=True)

    # --- pieces ---------------------------------------------------------------------------------------

    def missing(self, file: bytes, first: int, pieces: list[Piece]) -> list[int]:
        """The numbers of offered pieces that are not on disk; pieces of stored bundles are copied."""
        self._index_bundles()
        arrived = self._arrived_of(file)
        for number, piece in enumerate(pieces, first):
            if number not in arrived and (data := self._copy_of(piece)) is not None:
                self.put(file, number, data)
        return [number for number in range(first, first + len(pieces)) if number not in arrived]

    def put(self, file: bytes, number: int, data: bytes) -> None:
        """Store a piece. Raises OutputFileError, also when the disk would be nearly full."""
        if shutil.disk_usage(self._staging).free < RESERVE:
            raise OutputFileError(str(self._staging), f"less than {RESERVE >> 20} MiB are free on its disk")
        write_private(self._upload(file) / str(number), data, durable=True)
        self._arrived_of(file).add(number)

    def joined(self, file: bytes) -> bytes:
        """The bytes of all stored pieces of a file, in order; b"" if one was deleted meanwhile."""
        folder = self._upload(file)
        with suppress(OSError):
            return b"".join((folder / str(number)).read_bytes() for number in sorted(self._arrived_of(file)))
        return b""

    def drop(self, file: bytes) -> None:
        """Remove the pieces of a file."""
        shutil.rmtree(self._upload(file), ignore_errors=True)
        self._arrived.pop(file, None)

    def start_upload(self, file: bytes, under_way: Collection[bytes]) -> None:
        """Make room for the pieces of a file: the oldest others that are not `under_way` are removed."""
        folder = private_folder(self._upload(file))
        os.utime(folder)
        uploads = (each for each in self._staging.iterdir() if _DIGEST.fullmatch(each.name))
        found = sorted(uploads, key=lambda each: each.stat().st_mtime, reverse=True)
        others = [old for old in found if old != folder and bytes.fromhex(old.name) not in under_way]
        for old in others[max(0, KEPT_UPLOADS - 1 - len(under_way)) :]:
            shutil.rmtree(old, ignore_errors=True)
            self._arrived.pop(bytes.fromhex(old.name), None)

    def _upload(self, file: bytes) -> Path:
        return self._staging / file.hex()

    def _arrived_of(self, file: bytes) -> set[int]:
        if file not in self._arrived:
            folder = self._upload(file)
            names = os.listdir(folder) if folder.is_dir() else []
            self._arrived[file] = {int(name) for name in names if name.isdigit()}
        return self._arrived[file]

    def _index_bundles(self) -> None:
        """Find the pieces of stored bundles."""
        for digest in self.stored():
            path = self.path(digest)
            if path not in self._indexed and (data := self.read(digest)) is not None:
                self._indexed.add(path)
                self._known |= {piece_of(part).digest: (path, at) for at, part in _with_offsets(data)}

    def _copy_of(self, piece: Piece) -> bytes | None:
        """The bytes of a piece that a stored bundle has."""
        path, offset = self._known.get(piece.digest, (None, 0))
        if path is None:
            return None
        with suppress(OSError), path.open("rb") as opened:
            opened.seek(offset)
            data = opened.read(piece.size)
            return data if piece_of(data) == piece else None
        return None


def _with_offsets(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    for part in split(data):
        yield at, part
        at += len(part)
