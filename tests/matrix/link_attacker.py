"""A peer on a host's link that knows the protocol and may violate it.

The peer uses OpenSSL over a socket and frames as bytes instead of lfield's links. Only `ask_at_socket` uses
the code of lfield's commands.
"""

from __future__ import annotations

import asyncio
import ssl
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress

from lfield.authority.key_material import Keys
from lfield.errors import LfieldError, WireError
from lfield.net.tcp_transport import TcpTransport
from lfield.operator.observer_link import Request, send_request
from lfield.wire.codec import TRANSFER, decode, encode, frame_decoder, limits
from lfield.wire.messages import Message, Ping, Pong
from lfield.wire.observer_messages import EmergencyStopResult

#: The size limit of a transfer block, which no transfer reaches.
_BLOCK = 1 << 16
#: Seconds for a host to answer or to close the connection.
TIMEOUT = 60.0
#: Tokens of the pings: of the last message, and of the first.
TOKEN, FIRST = 77, 1
#: The answer of a host without agents.
ANSWER = EmergencyStopResult({})


def context(keys: Keys | None) -> ssl.SSLContext:
    """TLS without verification, with these keys or none."""
    made = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    made.check_hostname, made.verify_mode = False, ssl.CERT_NONE
    if keys is not None:
        with tempfile.NamedTemporaryFile() as file:
            file.write(keys.certificate + b"\n" + keys.key)
            file.flush()
            made.load_cert_chain(file.name)
    return made


class Attacker:
    """One connection. With a `context` it uses TLS; `bent` changes the bytes on the wire.

    The sent bytes are in `sent`, by pieces.
    """

    def __init__(
        self, context: ssl.SSLContext | None, bent: Callable[[int, bytes], bytes] = lambda number, data: data
    ) -> None:
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._incoming, self._outgoing) if context is not None else None
        self._bent = bent
        self.sent: list[bytes] = []
        self._frames = frame_decoder(lambda header, size: None)
        self._frames.limits = limits("host", _BLOCK)
        self.received: list[Message] = []

    async def open(self, address: str) -> None:
        """Connect, and perform the handshake as far as the host does."""
        if address.startswith("unix:"):
            self._reader, self._writer = await asyncio.open_unix_connection(address.removeprefix("unix:"))
        else:
            host, _, port = address.rpartition(":")
            self._reader, self._writer = await asyncio.open_connection(host, int(port))
        while self._tls is not None:
            try:
                self._tls.do_handshake()
                await self._flush()
                return
            except ssl.SSLWantReadError:
                await self._flush()
                if not (data := await self._read()):
                    return
                self._incoming.write(data)

    async def say(self, data: bytes) -> None:
        """Send bytes, in TLS if there is any."""
        if self._tls is None:
            await self._put(data)
        else:
            self._tls.write(data)
            await self._flush()

    async def repeat(self, pieces: list[bytes]) -> None:
        """Send the bytes of another connection."""
        for piece in pieces:
            await self._put(piece)

    async def listen(self, token: int) -> None:
        """Wait until the host has answered that ping, or has closed the connection."""
        async with asyncio.timeout(TIMEOUT):
            while Pong(token) not in self.received:
                if not (data := await self._read()):
                    return
                try:
                    self.received += self._messages(data)
                except (ssl.SSLError, WireError):
                    return

    async def hang_up(self) -> None:
        """Close the connection."""
        self._writer.close()
        with suppress(OSError):
            await self._writer.wait_closed()

    def _messages(self, data: bytes) -> Iterator[Message]:
        for plain in self._plain(data):
            for kind, payload in self._frames.feed(plain):
                if kind != TRANSFER:
                    yield decode(kind, payload)

    def _plain(self, data: bytes) -> Iterator[bytes]:
        if self._tls is None:
            yield data
            return
        self._incoming.write(data)
        with suppress(ssl.SSLWantReadError, ssl.SSLZeroReturnError):
            while plain := self._tls.read(1 << 16):
                yield plain

    async def _read(self) -> bytes:
        """Received bytes; b"" after the host has closed the connection."""
        try:
            return await self._reader.read(1 << 16)
        except OSError:
            return b""

    async def _flush(self) -> None:
        if data := self._outgoing.read():
            await self._put(data)

    async def _put(self, data: bytes) -> None:
        data = self._bent(len(self.sent), data)
        self.sent.append(data)
        with suppress(OSError):
            self._writer.write(data)
            await self._writer.drain()


async def send_messages(
    attacker: Attacker,
    address: str,
    messages: Sequence[bytes],
    between: Callable[[], None] | None = None,
) -> None:
    """Send these messages on a link, until the host has received all or closes the connection.

    `between` is called after the host has received the first message, the Hello.
    """
    await attacker.open(address)
    if between is not None:
        await attacker.say(messages[0] + encode(Ping(FIRST)))
        await attacker.listen(FIRST)
        between()
    for word in messages[between is not None :]:
        await attacker.say(word)
    await attacker.listen(TOKEN)
    await attacker.hang_up()


async def repeated(address: str, pieces: list[bytes]) -> Attacker:
    """A new link on which the bytes of an earlier link are sent again."""
    attacker = Attacker(None)
    await attacker.open(address)
    await attacker.repeat(pieces)
    await attacker.listen(TOKEN)
    await attacker.hang_up()
    return attacker


async def ask_at_socket(path: str, message: Message) -> bool:
    """Send a message at a socket as a command of lfield does; returns whether it was answered."""
    request = Request(message, EmergencyStopResult, TIMEOUT)
    try:
        return await send_request(TcpTransport(_BLOCK), path, request, "alpha") == ANSWER
    except LfieldError:
        return False
