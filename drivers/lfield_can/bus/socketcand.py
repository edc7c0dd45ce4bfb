"""An asyncio client of socketcand (https://github.com/linux-can/socketcand/blob/master/doc/protocol.md).

python-can's client needs two threads, loops without data when its server has died, and rejects an answer that
arrives together with the first frame.
"""

from __future__ import annotations

import asyncio
import socket
from typing import cast

from lfield.driver import DeviceError
from lfield.driver.network import Lookup, connected
from lfield_can.bus.endpoint import Endpoint
from lfield_can.bus.frames import BUS_LOST, Frame, Listener

#: Seconds for a server to connect and to answer.
ANSWER = 2.0
#: Bytes in the send buffers, here and in the kernel, some hundred frames each: a late command is worse than
#: none.
BACKLOG = 4096
#: Bytes of the longest valid message.
LONGEST = 256
#: Hexadecimal digits of an 11-bit and a 29-bit id, and the highest of each.
STANDARD, EXTENDED = 3, 8
STANDARD_ID, EXTENDED_ID = 0x7FF, 0x1FFFFFFF
#: Bytes of data in a classic frame.
LONGEST_DATA = 8
#: By host and port: a resolver that hangs is not called a second time.
_lookups: dict[tuple[str, int], Lookup] = {}


async def open_socketcand(endpoint: Endpoint, listener: Listener) -> Socketcand:
    """Connects to a server and opens the bus of an endpoint. Raises DeviceError."""
    assert endpoint.server is not None
    lookup = _lookups.setdefault(endpoint.server, Lookup(*endpoint.server, socket.SOCK_STREAM))
    client = Socketcand(listener)
    try:
        client, _ = await connected(lookup, ANSWER, lambda: Socketcand(listener))
        async with asyncio.timeout(ANSWER):
            await client.greet(str(endpoint.arguments["channel"]))
    except OSError as error:
        await client.close()
        # A TimeoutError of asyncio has no text.
        reason = error.strerror or str(error) or f"no greeting within {ANSWER:g} s"
        raise DeviceError("endpoint", f"cannot open {endpoint.text}: {reason}") from None
    return client


class Socketcand(asyncio.Protocol):
    """A connection in raw mode."""

    #: The protocol does not report it.
    is_off = False

    def __init__(self, listener: Listener) -> None:
        self.malformed = 0
        self._listener = listener
        self._transport: asyncio.Transport | None = None
        self._unread = b""
        self._answers: asyncio.Queue[bytes] | None = asyncio.Queue()

    async def greet(self, channel: str) -> None:
        """Opens a bus in raw mode. Raises ConnectionError."""
        await self._expect(b"hi")
        for command in (f"< open {channel} >", "< rawmode >"):
            self._write(command.encode())
            await self._expect(b"ok")
        self._answers = None

    async def _expect(self, expected: bytes) -> None:
        assert self._answers is not None
        answer = await self._answers.get()
        if answer != expected:
            raise ConnectionError(f"the server says '{answer.decode(errors='replace')}'")

    # -- sending ------------------------------------------------------------------------------------------

    async def send(self, frame: Frame) -> str:
        """Sends a frame; '' or the reason for a failure."""
        return self._send(frame)

    def post(self, frame: Frame) -> None:
        """Queues a frame; never waits."""
        self._send(frame)

    def _send(self, frame: Frame) -> str:
        if frame.fd:
            return "socketcand does not support CAN FD"
        digits = EXTENDED if frame.extended else STANDARD
        data = frame.data.hex(" ")
        return self._write(f"< send {frame.id:0{digits}X} {len(frame.data)} {data} >".encode())

    def _write(self, message: bytes) -> str:
        if self._transport is None or self._transport.is_closing():
            return BUS_LOST
        if self._transport.get_write_buffer_size() > BACKLOG:
            return "the send queue is full"
        self._transport.write(message)
        return ""

    async def close(self) -> None:
        """Closes the connection without a callback."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.abort()

    # -- received data ------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """The connection is open."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is no subclass of it
        connection = transport.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BACKLOG)

    def connection_lost(self, exc: Exception | None) -> None:
        """The server has closed the connection."""
        if self._transport is None:
            return
        self._transport = None
        if self._answers is not None:
            self._answers.put_nowait(b"nothing")
        else:
            reason = getattr(exc, "strerror", None) or (
                str(exc) if exc else "the server has closed the connection"
            )
            self._listener.lost(reason)

    def data_received(self, data: bytes) -> None:
        """A part of the stream of messages, each between < and >."""
        *messages, self._unread = (self._unread + data).split(b">")
        for message in messages:
            _, _, text = message.rpartition(b"<")
            self._on_text(text.strip())
        if len(self._unread) > LONGEST:
            self.malformed += 1
            self._unread = b""

    def _on_text(self, text: bytes) -> None:
        fields = text.split()
        if (frame := _frame(fields)) is not None:
            self._listener.frame(frame)
        elif (identifier := _error(fields)) is not None:
            # The protocol has no data for it.
            self._listener.error(identifier, b"\0")
        elif self._answers is not None:
            self._answers.put_nowait(text)
        else:
            self.malformed += 1


def _frame(fields: list[bytes]) -> Frame | None:
    """`frame ID TIME DATA`."""
    if len(fields) < 3 or fields[0] != b"frame":
        return None
    try:
        identifier, data = int(fields[1], 16), bytes.fromhex(b"".join(fields[3:]).decode())
    except ValueError:
        return None
    extended = len(fields[1]) != STANDARD
    if not 0 <= identifier <= (EXTENDED_ID if extended else STANDARD_ID) or len(data) > LONGEST_DATA:
        return None
    return Frame(identifier, data, extended)


def _error(fields: list[bytes]) -> int | None:
    """The id in `error ID TIME`."""
    if len(fields) != 3 or fields[0] != b"error":
        return None
    try:
        return int(fields[1], 16) & EXTENDED_ID
    except ValueError:
        return None
