"""A client of socketcand, on the loop (https://github.com/linux-can/socketcand/blob/master/doc/protocol.md).

Not python-can's: that one needs a thread to read and one to send, finds nothing for ever and at once when its
server has died, and takes an answer that comes together with the first frame for a wrong one.
"""

from __future__ import annotations

import asyncio
import socket
from typing import cast

from lfield.driver import DeviceError
from lfield.driver.network import Lookup, connected
from lfield_can.bus.endpoint import Place
from lfield_can.bus.frames import GONE, Frame, Listener

#: Seconds that a server may take to connect and to answer.
ANSWER = 2.0
#: Bytes that may wait to be sent, here and in the kernel, some hundred frames each: a late command is worse
#: than none.
BACKLOG = 4096
#: Bytes of the longest message; what is longer is none.
LONGEST = 256
#: Digits of an id of 11 bits and of one of 29, and the highest of each.
STANDARD, EXTENDED = 3, 8
STANDARD_ID, EXTENDED_ID = 0x7FF, 0x1FFFFFFF
#: Bytes of data in a frame that is not of CAN FD.
LONGEST_DATA = 8
#: By host and port: a name that hangs while it is resolved is not asked for a second time meanwhile.
_lookups: dict[tuple[str, int], Lookup] = {}


async def open_socketcand(place: Place, listener: Listener) -> Socketcand:
    """Connect and open the bus of an endpoint. Raises DeviceError."""
    assert place.server is not None
    lookup = _lookups.setdefault(place.server, Lookup(*place.server, socket.SOCK_STREAM))
    client = Socketcand(listener)
    try:
        client, _ = await connected(lookup, ANSWER, lambda: Socketcand(listener))
        async with asyncio.timeout(ANSWER):
            await client.greet(str(place.arguments["channel"]))
    except OSError as error:
        await client.close()
        # A TimeoutError of asyncio says nothing.
        reason = error.strerror or str(error) or f"no greeting within {ANSWER:g} s"
        raise DeviceError("endpoint", f"cannot open {place.text}: {reason}") from None
    return client


class Socketcand(asyncio.Protocol):
    """A connection in raw mode, once it was greeted."""

    #: The protocol does not tell.
    off = False

    def __init__(self, listener: Listener) -> None:
        self.malformed = 0
        self._listener = listener
        self._transport: asyncio.Transport | None = None
        self._unread = b""
        self._answers: asyncio.Queue[bytes] | None = asyncio.Queue()

    async def greet(self, channel: str) -> None:
        """Open a bus and have all its frames. Raises ConnectionError."""
        await self._expect(b"hi")
        for command in (f"< open {channel} >", "< rawmode >"):
            self._write(command.encode())
            await self._expect(b"ok")
        self._answers = None

    async def _expect(self, wanted: bytes) -> None:
        assert self._answers is not None
        answer = await self._answers.get()
        if answer != wanted:
            raise ConnectionError(f"the server says '{answer.decode(errors='replace')}'")

    # -- sending ------------------------------------------------------------------------------------------

    async def send(self, frame: Frame) -> str:
        """Send a frame; '' or why it was not sent."""
        return self._send(frame)

    def post(self, frame: Frame) -> None:
        """Send a frame, or not; never waits."""
        self._send(frame)

    def _send(self, frame: Frame) -> str:
        if frame.fd:
            return "socketcand has no frames of CAN FD"
        digits = EXTENDED if frame.extended else STANDARD
        data = frame.data.hex(" ")
        return self._write(f"< send {frame.id:0{digits}X} {len(frame.data)} {data} >".encode())

    def _write(self, message: bytes) -> str:
        if self._transport is None or self._transport.is_closing():
            return GONE
        if self._transport.get_write_buffer_size() > BACKLOG:
            return "too many frames wait to be sent"
        self._transport.write(message)
        return ""

    async def close(self) -> None:
        """Hang up; nobody is told."""
        transport, self._transport = self._transport, None
        if transport is not None:
            transport.abort()

    # -- what comes in ------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is connected."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is no subclass of it
        connection = transport.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BACKLOG)

    def connection_lost(self, exc: Exception | None) -> None:
        """The server has hung up, unless we have."""
        if self._transport is None:
            return
        self._transport = None
        if self._answers is not None:
            self._answers.put_nowait(b"nothing")
        else:
            reason = getattr(exc, "strerror", None) or (str(exc) if exc else "the other end has hung up")
            self._listener.lost(reason)

    def data_received(self, data: bytes) -> None:
        """A part of the stream of messages, each between < and >."""
        *messages, self._unread = (self._unread + data).split(b">")
        for message in messages:
            _, _, text = message.rpartition(b"<")
            self._take(text.strip())
        if len(self._unread) > LONGEST:
            self.malformed += 1
            self._unread = b""

    def _take(self, text: bytes) -> None:
        words = text.split()
        if (frame := _frame(words)) is not None:
            self._listener.frame(frame)
        elif (identifier := _error(words)) is not None:
            # The protocol has no data with it.
            self._listener.error(identifier, b"\0")
        elif self._answers is not None:
            self._answers.put_nowait(text)
        else:
            self.malformed += 1


def _frame(words: list[bytes]) -> Frame | None:
    """`frame ID TIME DATA`."""
    if len(words) < 3 or words[0] != b"frame":
        return None
    try:
        identifier, data = int(words[1], 16), bytes.fromhex(b"".join(words[3:]).decode())
    except ValueError:
        return None
    extended = len(words[1]) != STANDARD
    if not 0 <= identifier <= (EXTENDED_ID if extended else STANDARD_ID) or len(data) > LONGEST_DATA:
        return None
    return Frame(identifier, data, extended)


def _error(words: list[bytes]) -> int | None:
    """The id in `error ID TIME`."""
    if len(words) != 3 or words[0] != b"error":
        return None
    try:
        return int(words[1], 16) & EXTENDED_ID
    except ValueError:
        return None
