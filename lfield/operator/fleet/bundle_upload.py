"""Transfers a bundle to a service in pieces; an interrupted transfer continues where it ended.

The service reports the pieces that it does not have, on disk or in another bundle, and only these are sent.
Every piece is confirmed when it is on disk. After a broken link the pieces are offered again.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from hashlib import sha256

from msgspec import Struct

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
#: Seconds for a host to verify a bundle, and between two offers to a host that stores other bundles first.
STAGE_TIMEOUT, BUSY_DELAY = 30.0, 1.0


class Upload(Struct, frozen=True):
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


class UploadProgress(Struct):
    """Progress of an upload to one host, in pieces. `sent` counts the bytes of pieces as they were sent.

    `refusal` is the reason why the host does not store the bundle, '' if it does, `code` its error code. With
    `is_deferred` the host will store it later.
    """

    stored: int = 0
    total: int = 0
    sent: int = 0
    attempts: int = 0
    refusal: str = ""
    code: str = ""
    is_deferred: bool = False

    def on_answer(self, answer: PieceRequest | PieceStored | StageResult) -> None:
        """Add the refusal in an answer; the first one counts."""
        if answer.trouble and not self.refusal:
            self.refusal, self.is_deferred = answer.trouble, answer.retry


async def upload(
    links: ServiceLinks,
    host: str,
    source: Upload,
    *,
    patience: float,
    on_progress: Callable[[UploadProgress], None] = lambda progress: None,
) -> UploadProgress:
    """Transfer a bundle to the service of `host`, and have it verified and stored there.

    Links are made again, and a host that stores other bundles first is asked again, until no piece was
    confirmed for `patience` seconds. Raises AddressError, HandshakeError, KeysError.
    """
    progress = UploadProgress(total=len(source.pieces))
    now = asyncio.get_running_loop().time
    last, stored = now(), 0
    while True:
        broken: AddressError | None = None
        try:
            async with links.link(host) as link:
                progress.attempts += 1
                await _transfer(link, source, progress, on_progress)
        except AddressError as error:
            broken = error
        if broken is None and not progress.is_deferred:
            return progress
        if progress.stored > stored:
            last, stored = now(), progress.stored
        if now() - last > patience:
            if broken is not None:
                raise broken
            return progress
        on_progress(progress)
        await asyncio.sleep(RETRY_DELAY if broken is not None else BUSY_DELAY)


async def _transfer(
    link: ServiceLink,
    source: Upload,
    progress: UploadProgress,
    on_progress: Callable[[UploadProgress], None],
) -> None:
    """One attempt, until the host has stored the bundle or refuses it. Raises LfieldError."""
    progress.stored, progress.refusal, progress.is_deferred = 0, "", False
    for first in range(0, len(source.pieces), MAX_OFFER):
        await _send_missing(link, source, first, progress, on_progress)
        if progress.refusal:
            return
    result = await link.ask(StageRequest(source.digest, source.file), StageResult, STAGE_TIMEOUT)
    progress.on_answer(result)
    progress.code = result.code


async def _send_missing(
    link: ServiceLink,
    source: Upload,
    first: int,
    progress: UploadProgress,
    on_progress: Callable[[UploadProgress], None],
) -> None:
    """Offer pieces from number `first`, and send those that are missing, until the host refuses one.

    Every answer was received at the end: the link may be used again. Raises LfieldError.
    """
    offered = source.pieces[first : first + MAX_OFFER]
    entries = [(piece.digest, piece.size) for piece in map(piece_of, offered)]
    offer = BundleOffer(source.digest, source.file, source.size, len(source.pieces), first, entries)
    request = await link.ask(offer, PieceRequest)
    progress.on_answer(request)
    if request.trouble:
        return
    progress.stored += len(offered) - len(request.missing)
    on_progress(progress)
    under_way = 0
    for number in request.missing:
        packed, data = compress(source.pieces[number])
        link.send(BundlePiece(source.file, number, packed, data))
        progress.sent += len(data)
        under_way += 1
        if under_way >= WINDOW:
            await _confirmed(link, progress, on_progress)
            under_way -= 1
        if progress.refusal:
            break
    for _ in range(under_way):
        await _confirmed(link, progress, on_progress)


async def _confirmed(
    link: ServiceLink, progress: UploadProgress, on_progress: Callable[[UploadProgress], None]
) -> None:
    answer = await link.receive(PieceStored)
    progress.on_answer(answer)
    progress.stored += not answer.trouble
    on_progress(progress)
