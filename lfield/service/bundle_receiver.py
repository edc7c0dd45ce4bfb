"""Receives bundles in pieces, verifies them, and describes the stored ones."""

from __future__ import annotations

from collections.abc import Callable, Collection
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple, Protocol

from lfield.authority.admission_policy import CertificateAdmission
from lfield.authority.key_material import Keys
from lfield.errors import BundleError, LfieldError, OutputFileError, SignatureError, WireError
from lfield.mission import bundle
from lfield.mission.access.access_rules import Access
from lfield.mission.access.signed_bundle import accept_bundle
from lfield.mission.mission import Mission
from lfield.mission.relocation import companion_files
from lfield.service import messages
from lfield.text.log_messages import LogLine
from lfield.text.suggestions import listed
from lfield.wire.bundle_pieces import Piece, decompress
from lfield.wire.fields import MAX_LABEL, short_digest, truncate
from lfield.wire.service_messages import (
    MAX_COORDINATORS,
    MAX_HOSTS,
    BundleInfo,
    BundleOffer,
    BundlePiece,
    MissionCommand,
    PieceRequest,
    PieceStored,
    StageRequest,
    StageResult,
)

#: The most uploads at once, and seconds without a piece after which one gives way to another.
MAX_UPLOADS, UPLOAD_TIMEOUT = 2, 30.0


class BundleFiles(Protocol):
    """The bundles on the disk of a service (`bundle_store.BundleStore`). Writing raises OutputFileError."""

    def stored(self) -> list[bytes]: ...
    def read(self, digest: bytes) -> bytes | None: ...
    def add(self, digest: bytes, data: bytes, protected: list[bytes]) -> None: ...
    def start_upload(self, file: bytes, under_way: Collection[bytes]) -> None: ...
    def missing(self, file: bytes, first: int, pieces: list[Piece]) -> list[int]: ...
    def put(self, file: bytes, number: int, data: bytes) -> None: ...
    def joined(self, file: bytes) -> bytes: ...
    def drop(self, file: bytes) -> None: ...


#: The verified bundle in some bytes. Raises LfieldError.
Verify = Callable[[bytes], BundleInfo]


class ArrivingUpload(NamedTuple):
    """An upload under way: its sender, and the time of its last piece or offer (monotonic)."""

    operator: str
    at: float


class BundleReceiver:
    """`verify` checks digest and signature of a bundle; `protected` are those that are never removed."""

    def __init__(
        self,
        files: BundleFiles,
        verify: Verify,
        protected: Callable[[], list[bytes]],
        note: Callable[[LogLine], None],
        now: Callable[[], float],
    ) -> None:
        self._files, self._verify, self._protected = files, verify, protected
        self._note, self._now = note, now
        self._infos: dict[bytes, BundleInfo] = {}
        #: Uploads by file. After a restart of the service the desks offer their pieces again.
        self._uploads: dict[bytes, ArrivingUpload] = {}

    def on_offer(self, offer: BundleOffer, operator: str) -> PieceRequest:
        """The pieces of an offer that are missing."""
        if self._has_file(offer.digest, offer.file):
            return PieceRequest(offer.file, offer.first, [])
        now = self._now()
        self._uploads = {
            file: upload
            for file, upload in self._uploads.items()
            if file != offer.file and now - upload.at < UPLOAD_TIMEOUT
        }
        if len(self._uploads) >= MAX_UPLOADS:
            senders = listed(list(dict.fromkeys(upload.operator for upload in self._uploads.values())))
            busy = f"other bundles are arriving, sent by {senders}: repeat it when they are stored"
            return PieceRequest(offer.file, offer.first, [], busy, retry=True)
        try:
            self._files.start_upload(offer.file, list(self._uploads))
            self._uploads[offer.file] = ArrivingUpload(operator, now)
            pieces = [Piece(*each) for each in offer.pieces]
            return PieceRequest(offer.file, offer.first, self._files.missing(offer.file, offer.first, pieces))
        except OutputFileError as error:
            return PieceRequest(offer.file, offer.first, [], truncate(str(error)))

    def on_piece(self, piece: BundlePiece) -> PieceStored:
        """Store a piece. Raises WireError for a damaged one."""
        data = decompress(piece.data, is_compressed=piece.is_compressed)
        upload = self._uploads.get(piece.file)
        if upload is None:
            reason = "it gave way to another upload, or another desk has sent the same file"
            return PieceStored(piece.file, piece.number, reason, retry=True)
        self._uploads[piece.file] = upload._replace(at=self._now())
        try:
            self._files.put(piece.file, piece.number, data)
        except OutputFileError as error:
            return PieceStored(piece.file, piece.number, truncate(str(error)))
        return PieceStored(piece.file, piece.number)

    def on_stage(self, request: StageRequest) -> StageResult:
        """Store the bundle of all received pieces, if it is valid."""
        if self._has_file(request.digest, request.file) and self.is_valid(request.digest):
            # Another desk has sent the same file at the same time.
            self._drop(request.file)
            return StageResult(request.digest)
        retry = False
        try:
            data = self._files.joined(request.file)
            if retry := sha256(data).digest() != request.file:
                self._drop(request.file)
                raise WireError("pieces of the file are missing: push it again")
            info = self._verify(data)
            if info.digest != request.digest:
                raise SignatureError(
                    f"the file is bundle {short_digest(info.digest)}, another one was offered"
                )
            self._files.add(info.digest, data, self._protected())
            self._drop(request.file)
        except LfieldError as error:
            self._note(messages.BUNDLE_REFUSED.line(bundle=short_digest(request.digest), reason=error))
            return StageResult(request.digest, truncate(str(error)), error.code, retry)
        self._infos[info.digest] = info
        self._note(
            messages.BUNDLE_STORED.line(bundle=short_digest(info.digest), mission=info.name, by=info.by)
        )
        return StageResult(request.digest)

    def _drop(self, file: bytes) -> None:
        self._files.drop(file)
        self._uploads.pop(file, None)

    def _has_file(self, digest: bytes, file: bytes) -> bool:
        """Whether exactly this file of a bundle, with its signature, is stored."""
        data = self._files.read(digest)
        return data is not None and sha256(data).digest() == file

    def is_valid(self, digest: bytes) -> bool:
        """Whether a bundle is stored and valid now: keys may have been revoked since it was received."""
        data = self._files.read(digest)
        try:
            return data is not None and self._verify(data).digest == digest
        except LfieldError:
            return False

    def start_refusal(self, digest: bytes, command: MissionCommand, person: str) -> str:
        """The reason why a command may not start the active bundle `digest`, or ''. Raises BundleError."""
        if command.digest not in (b"", digest):
            other, active = short_digest(command.digest), short_digest(digest)
            return (
                f"bundle {other} is not active here, but {active}: 'lfield push' activates one on all hosts"
            )
        info = self.info(digest)
        hosts = info.hosts if info is not None else []
        if unknown := [host for host in command.without if hosts and host not in hosts]:
            return f"its mission has no host {listed(unknown)}"
        if not command.is_assistant:
            return ""
        data = self._files.read(digest)
        return "its bundle was deleted" if data is None else access_of(data).assistant_refusal(person)

    def infos(self, limit: int) -> list[BundleInfo]:
        """The newest stored bundles that are valid."""
        found = [self.info(digest) for digest in self._files.stored()[:limit]]
        return [info for info in found if info is not None]

    def info(self, digest: bytes) -> BundleInfo | None:
        """The description of a stored bundle that is valid; None without one."""
        if digest not in self._infos and (data := self._files.read(digest)) is not None:
            try:
                self._infos[digest] = self._verify(data)
            except LfieldError:
                return None
        return self._infos.get(digest)


class BundleVerifier:
    """Checks format, digests, program and signature, that `host` belongs to the mission, and its files.

    `folder` has the files that devices need, such as a DBC file.
    """

    def __init__(self, host: str, keys: Keys, admission: CertificateAdmission, folder: Path) -> None:
        self._host, self._keys, self._admission, self._folder = host, keys, admission, folder

    def __call__(self, data: bytes) -> BundleInfo:
        """The bundle in some bytes. Raises BundleError, SignatureError."""
        mission = bundle.decode(data)
        if self._host not in mission.team.hosts:
            raise BundleError(f"its mission has no host {self._host}", "push it with --without this host")
        if missing := [file for file in companion_files(mission, self._host) if not self._has(file)]:
            raise BundleError(
                f"its devices need {listed(missing)}, which {self._folder} does not have",
                "name them in the inventory ('files'), and run 'lfield provision'",
            )
        release = accept_bundle(
            mission.release,
            self._keys.authority,
            self._admission.own.authority,
            at=self._admission.time.now(),
            revoked=self._admission.revoked,
        ).bundle
        self._admission.time.on_signature(release.at, f"the signature of bundle {release.short}")
        return BundleInfo(
            release.digest,
            truncate(mission.name, MAX_LABEL),
            release.by,
            release.at,
            list(mission.team.hosts[:MAX_HOSTS]),
            homes_of(mission),
        )

    def _has(self, file: str) -> bool:
        return (self._folder / file).is_file()


def homes_of(mission: Mission) -> dict[str, str]:
    """The coordinators of a mission, each with the host on which it starts."""
    team = mission.team
    return {
        coordinator.id: team.hosts[coordinator.host]
        for coordinator in team.initial_coordinators[:MAX_COORDINATORS]
    }


def access_of(data: bytes) -> Access:
    """The access rules in a verified bundle. Raises BundleError."""
    return bundle.decode(data).access


def vehicles_of(data: bytes, host: str) -> list[str]:
    """The vehicles of a host in a verified bundle. Raises BundleError."""
    return bundle.decode(data).vehicles_of(host)
