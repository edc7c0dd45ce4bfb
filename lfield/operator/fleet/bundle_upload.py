"""Transfers a bundle to a service in pieces; an interrupted transfer continues where it ended.

The service says which pieces it does not have, on disk or in another bundle, and only these are sent. Every
piece is confirmed when it is on disk. After a broken link the pieces are offered again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256

from lfield.errors import AddressError
from lfield.mission import bundle
from lfield.operator.fleet.service_link import RETRY_DELAY, ServiceLink, ServiceLinks
from lfield.wire.bundle_pieces import compress, piece_of, split
from lfield.wire.service_messages import (
    MAX_OFFER,
    BundleOffer,
    BundlePiece,
    PieceRequest,
    PieceStored,
    StageRequest,
    StageResult,
)

#: Pieces that are sent before the first is confirmed.
WINDOW = 8
#: Seconds for a host to verify a bundle.
STAGE_TIMEOUT = 30.0


@dataclass(frozen=True, slots=True)
class Upload:
    """A bundle in pieces. `digest` is that of the bundle, `file` that of its bytes."""

    digest: bytes
    file: bytes
    pieces: tuple[bytes, ...]

    @classmethod
    def of(cls, data: bytes) -> Upload:
        """The upload of the bytes of a bundle. Raises BundleError."""
        return cls(bundle.contents(data).digest, sha256(data).digest(), tuple(split(data)))

    @property
    def size(self) -> int:
        """Bytes of the whole file."""
        return sum(map(len, self.pieces))


@dataclass(slots=True)
class UploadProgress:
    """Progress of an upload to one host, in pieces. `sent` counts the bytes of pieces as they were sent.

    `refusal` is why the host does not store the bundle, '' if it does, `code` the code of its error.
    """

    stored: int = 0
    total: int = 0
    sent: int = 0
    attempts: int = 0
    refusal: str = ""
    code: str = ""


async def upload(
    links: ServiceLinks,
    host: str,
    what: Upload,
    *,
    patience: float,
    on_progress: Callable[[UploadProgress], None] = lambda progress: None,
) -> UploadProgress:
    """Transfer a bundle to the service of `host`, and have it verified and stored there.

    Links are made again until no piece was confirmed for `patience` seconds. Raises AddressError,
    HandshakeError, KeysError.
    """
    progress = UploadProgress(total=len(what.pieces))
    now = asyncio.get_running_loop().time
    last, stored = now(), 0
    while True:
        try:
            async with links.link(host) as link:
                progress.attempts += 1
                await _send_missing(link, what, progress, on_progress)
                if not progress.refusal:
                    request = StageRequest(what.digest, what.file)
                    result = await link.ask(request, StageResult, STAGE_TIMEOUT)
                    progress.refusal, progress.code = result.trouble, result.code
                return progress
        except AddressError as error:
            if progress.stored > stored:
                last, stored = now(), progress.stored
            if now() - last > patience:
                raise error
            await asyncio.sleep(RETRY_DELAY)


async def _send_missing(
    link: ServiceLink,
    what: Upload,
    progress: UploadProgress,
    on_progress: Callable[[UploadProgress], None],
) -> None:
    """Offer all pieces, and send those that are missing, until the host refuses one. Raises LfieldError."""
    progress.stored = 0
    for first in range(0, len(what.pieces), MAX_OFFER):
        some = what.pieces[first : first + MAX_OFFER]
        entries = [(piece.digest, piece.size) for piece in map(piece_of, some)]
        offer = BundleOffer(what.digest, what.file, what.size, len(what.pieces), first, entries)
        request = await link.ask(offer, PieceRequest)
        progress.refusal = progress.refusal or request.trouble
        progress.stored += len(some) - len(request.missing)
        on_progress(progress)
        under_way = 0
        for number in request.missing:
            if progress.refusal:
                return
            packed, data = compress(what.pieces[number])
            link.send(BundlePiece(what.file, number, packed, data))
            progress.sent += len(data)
            under_way += 1
            if under_way >= WINDOW:
                await _confirmed(link, progress, on_progress)
                under_way -= 1
        for _ in range(under_way):
            await _confirmed(link, progress, on_progress)


async def _confirmed(
    link: ServiceLink, progress: UploadProgress, on_progress: Callable[[UploadProgress], None]
) -> None:
    answer = await link.receive(PieceStored)
    progress.refusal = progress.refusal or answer.trouble
    progress.stored += not answer.trouble
    on_progress(progress)
