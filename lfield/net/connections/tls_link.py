"""A TLS link over an asyncio connection."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfield.errors import AddressError, HandshakeError, LfieldError
from lfield.net.scheduling.handshake_scheduler import source_of
from lfield.net.stream_link import StreamLink, anonymous_identity

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable, Iterator

    from lfield.net.scheduling.link_schedulers import LinkScheduler
    from lfield.net.tls import TlsChannel, TlsIdentity
    from lfield.net.transport import Link, LinkHandler
    from lfield.wire.framing import Buffer

#: Maximum bytes of TLS decrypted at a time, for guests and members: their decryption may take time without
#: completing a message.
OBSERVER_PIECE, MEMBER_PIECE = 1 << 10, 1 << 14


class TlsLink(StreamLink):
    """A stream link in TLS, which authenticates the peer. An accepted link holds no TLS state before bytes
    arrive."""

    def __init__(
        self,
        max_block: int,
        max_pending: int,
        on_link: Callable[[Link], LinkHandler],
        scheduler: LinkScheduler,
        tls: TlsIdentity,
        *,
        calls: bool,
    ) -> None:
        super().__init__(max_block, max_pending, on_link, scheduler, anonymous_identity, calls=calls)
        self._tls = tls
        self._channel: TlsChannel | None = None
        self._proven: asyncio.Future[None] = self._loop.create_future()
        #: The host that must answer; '' for any.
        self._required = ""
        #: The source of the peer's address for rationing, and seconds of CPU time used by its handshake.
        self._source = ""
        self._spent = 0.0
        #: Decrypted text that has to be queued, and the error that followed it.
        self._left_over: list[bytes] | None = None
        self._tls_error: LfieldError | None = None

    async def ready(self) -> None:
        await self._proven

    def require_host(self, host: str) -> None:
        self._required = host

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._source = source_of(self.peer)
        if self._calls:
            self._channel = self._tls.channel(calls=True, address=self.peer)
            self._transport.write(self._channel.data_to_send())

    def data_received(self, data: bytes) -> None:
        if (
            self._is_rationed
            and self._remaining is None
            and not self._is_held
            and len(data) <= MEMBER_PIECE
            and self._channel is not None
            and self._scheduler.members.process_at_once(self, self._member, data)
        ):
            if self._left_over is not None:
                self._process_coming(self._deliver_left_over(self._channel))
            return
        channel = self._channel = self._channel or self._tls.channel(calls=self._calls)
        coming = self._decrypted(channel, data)
        if channel.proven or self._calls:
            self._process_coming(coming)
            return
        self._remaining = coming
        handshakes, is_answered, self.is_answered = self._scheduler.handshakes, self.is_answered, True
        handshakes.add(self, self._source, is_answered=is_answered)
        self._update_reading()

    def receive_frame(self, data: Buffer) -> bool:
        """Decrypt these bytes and process them if they are exactly one frame; otherwise keep the plain text.

        See `FramedLink.receive_frame`.
        """
        channel = self._channel
        if channel is None or self.closed:
            return False
        records: list[bytes] = []
        try:
            records.extend(channel.receive(data))
        except LfieldError as error:
            self._tls_error = error
        if len(records) != 1 or self._tls_error is not None or not super().receive_frame(records[0]):
            self._left_over = records
        if channel.outgoing.pending:
            self._send_handshake(channel)
        return True

    def _deliver_left_over(self, channel: TlsChannel) -> Iterator[None]:
        """Process the text that `receive_frame` has decrypted and kept."""
        records, self._left_over = self._left_over, None
        error, self._tls_error = self._tls_error, None
        for plain in records or ():
            yield from self.deliver_pending(plain)
            if self.closed:
                return
        if error is not None:
            self._on_tls_error(channel, error)

    def advance_handshake(self) -> bool:
        """See `HandshakingLink.advance_handshake`. Data after the handshake is treated as data of an
        authenticated peer.
        """
        coming, channel = self._remaining, self._channel
        if coming is None or channel is None or self.closed:
            return False
        start = self._scheduler.busy()
        more = next(coming, coming) is None
        self._spent += self._scheduler.busy() - start
        if more and not channel.proven:
            return True
        self._remaining = None
        if channel.proven and channel.identity.kind == "host":
            self._join()
            self._scheduler.members.on_handshake(self, self._member, self._spent)
        if more and (self._is_rationed or self._is_observer):
            self._queue(coming)
        elif more:
            self._process_coming(coming)
        self._update_reading()
        return False

    def _decrypted(self, channel: TlsChannel, data: bytes) -> Iterator[None]:
        """Decrypt in small steps: a record may hold a thousand messages, or take time without
        containing any.
        """
        view = memoryview(data)
        size = MEMBER_PIECE if self._is_direct else OBSERVER_PIECE
        try:
            for start in range(0, len(view), size):
                for plain in channel.receive(view[start : start + size]):
                    self.identity = channel.identity
                    yield from self.deliver_pending(plain)
                    if self.closed:
                        return
                self._send_handshake(channel)
                self.identity = channel.identity
                if channel.proven and not self._proven.done():
                    self._check_host(channel)
                    self._proven.set_result(None)
                    self._scheduler.handshakes.on_proven(self._source)
                if start + size < len(view):
                    yield
        except LfieldError as error:
            self._on_tls_error(channel, error)

    def _check_host(self, channel: TlsChannel) -> None:
        identity, required = channel.identity, self._required
        if required and identity.kind == "host" and identity.name != required:
            raise HandshakeError(
                f"{identity.name} answered at an address of {required}; correct the address",
                answered_by=identity.name,
            )

    def _on_tls_error(self, channel: TlsChannel, error: LfieldError) -> None:
        self._error = self._error or error
        self._send_handshake(channel)
        self.close()

    def _put(self, data: Buffer) -> None:
        # Before authentication there is no handler to inform.
        if self._channel is not None and self._channel.proven:
            self._transport.write(self._channel.encrypt(data))

    def _send_handshake(self, channel: TlsChannel) -> None:
        if data := channel.data_to_send():
            self._transport.write(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._scheduler.handshakes.remove(self)
        if not (self._calls or self._proven.done()):
            self._scheduler.handshakes.on_failed(self._source)
        super().connection_lost(exc)

    def on_eof(self, error: LfieldError | None) -> None:
        if self._channel is not None and self._channel.proven:
            self._channel.end()
            if self._calls:
                self._tls.keep_session(self.peer, self._channel)
        # Release the TLS state now, not at garbage collection: unauthenticated links would accumulate until
        # then.
        self._channel = None
        if not self._calls or (self._proven.done() and not self._proven.cancelled()):
            super().on_eof(error)
        elif not self._proven.done():
            # The caller receives the error from `connect`, and has no link.
            lost = AddressError(self.peer, "peer closed the connection before authentication")
            self._proven.set_exception(self._error or error or lost)
