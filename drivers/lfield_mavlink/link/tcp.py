"""A TCP connection that is opened again when it breaks or falls silent."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from socket import SOCK_STREAM
from typing import cast

from lfield.driver.network import Attempts, Lookup, connected
from lfield_mavlink.link.events import AGAIN, ATTEMPT, LinkEvents, OnData, cannot_open, name_of, reason_of

#: Seconds without a byte after which a connection is given up: an autopilot's heartbeat comes each second.
SILENT = 5.0
#: Bytes that may wait to be sent; what is more is lost, as on a radio: a late command is worse than none.
BACKLOG = 1 << 16


class TcpLink:
    """A connection to a vehicle, a radio or a router."""

    def __init__(self, host: str, port: int, on_data: OnData, events: LinkEvents) -> None:
        self._lookup = Lookup(host, port, SOCK_STREAM)
        self._on_data, self._events = on_data, events
        self._name = name_of("tcp", self._lookup.host, port)
        self._attempts = Attempts(self._name)
        self._connection: _Connection | None = None
        self._task: asyncio.Task[None] | None = None
        self._hung_up = False

    async def open(self) -> None:
        """Connect, now. Raises DeviceError."""
        try:
            self._connection = await self._connect()
        except OSError as error:
            raise cannot_open(self._name, error) from None
        self._task = asyncio.get_running_loop().create_task(self._keep(self._connection))

    async def _connect(self) -> _Connection:
        """To the first of its addresses that answers. Raises OSError."""
        made, where = await connected(self._lookup, ATTEMPT, lambda: _Connection(self._on_data))
        made.where = where
        return made

    async def _keep(self, connection: _Connection) -> None:
        """Wait until the connection is lost, and open it again, until cancelled."""
        loop = asyncio.get_running_loop()
        while True:
            self._connection, self._hung_up = connection, False
            reason = await connection.until_lost(self._attempts)
            self._connection, self._hung_up = None, connection.is_lost
            connection.abort()
            self._events.log(self._attempts.lost(reason, loop.time()))
            connection = await self._reconnected()

    async def _reconnected(self) -> _Connection:
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection = await self._connect()
            except OSError as error:
                self._events.log(self._attempts.failed(reason_of(error), loop.time()))
                await asyncio.sleep(AGAIN)
                continue
            self._events.log(self._attempts.opened(f"connected to {connection.where}", loop.time()))
            self._events.reopened()
            return connection

    def send(self, data: bytes) -> None:
        """Into the stream, if there is one."""
        if self._connection is not None:
            self._connection.write(data)

    def send_to(self, data: bytes, address: str) -> None:
        """Into the stream: there is one far end."""
        self.send(data)

    def why_silent(self) -> str:
        """Connected, or not any more."""
        if self._hung_up:
            return f"{self._name} hung up"
        return (
            f"{self._name} is connected and says nothing; a simulator serves one client at a time: has it "
            "another?"
        )

    def close(self) -> None:
        """Hang up."""
        if self._task is not None:
            self._task.cancel()
        if self._connection is not None:
            self._connection.close()


class _Connection(asyncio.Protocol):
    """One connection; `where` is the address of its far end."""

    def __init__(self, on_data: OnData) -> None:
        self._on_data = on_data
        self._transport: asyncio.Transport | None = None
        self._lost = asyncio.Event()
        self._reason = "the other end has hung up"
        self._at = asyncio.get_running_loop().time()
        self._heard = False
        self.where = ""

    @property
    def is_lost(self) -> bool:
        """Whether the other end, or the system, has ended it."""
        return self._lost.is_set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is connected."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is no subclass of it

    def data_received(self, data: bytes) -> None:
        """Bytes of the stream."""
        self._at, self._heard = asyncio.get_running_loop().time(), True
        self._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """It has ended."""
        if exc is not None:
            self._reason = reason_of(exc)
        self._lost.set()

    async def until_lost(self, attempts: Attempts) -> str:
        """Why it does not work any more: it has ended, or nothing has come for SILENT seconds."""
        loop = asyncio.get_running_loop()
        while not self.is_lost:
            left = self._at + SILENT - loop.time()
            if left <= 0.0:
                return f"nothing came for {SILENT:g} s"
            with suppress(TimeoutError):
                async with asyncio.timeout(left):
                    await self._lost.wait()
            if self._heard:
                attempts.works()
        return self._reason

    def write(self, data: bytes) -> None:
        """Send bytes, unless too many wait already."""
        transport = self._transport
        if transport is not None and not self.is_lost and transport.get_write_buffer_size() <= BACKLOG:
            transport.write(data)

    def close(self) -> None:
        """Hang up."""
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """End it at once: what waits is lost."""
        if self._transport is not None:
            self._transport.abort()
