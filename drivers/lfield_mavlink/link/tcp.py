"""A TCP connection that is reopened when it breaks or falls silent."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from socket import SOCK_STREAM
from typing import cast

from lfield.driver.network import Attempts, Lookup, connected
from lfield_mavlink.link.link_events import (
    ATTEMPT_TIMEOUT,
    RETRY_INTERVAL,
    LinkEvents,
    OnData,
    cannot_open,
    name_of,
    reason_of,
)

#: Seconds without data after which a connection is closed: an autopilot's heartbeat comes each second.
SILENT = 5.0
#: Bytes that may be queued; more is dropped, since a late command is worse than none.
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
        """Connects. Raises DeviceError."""
        try:
            self._connection = await self._connect()
        except OSError as error:
            raise cannot_open(self._name, error) from None
        self._task = asyncio.get_running_loop().create_task(self._run(self._connection))

    async def _connect(self) -> _Connection:
        """Connects to the first address of the host that answers. Raises OSError."""
        connection, address = await connected(
            self._lookup, ATTEMPT_TIMEOUT, lambda: _Connection(self._on_data)
        )
        connection.address = address
        return connection

    async def _run(self, connection: _Connection) -> None:
        """Reopens the connection whenever it is lost, until cancelled."""
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
                await asyncio.sleep(RETRY_INTERVAL)
                continue
            self._events.log(self._attempts.opened(f"connected to {connection.address}", loop.time()))
            self._events.reopened()
            return connection

    def send(self, data: bytes) -> None:
        """Writes to the stream, if connected."""
        if self._connection is not None:
            self._connection.write(data)

    def send_to(self, data: bytes, address: str) -> None:
        """Writes to the stream, which has one peer."""
        self.send(data)

    def silence_reason(self) -> str:
        """The text for a silent connection: closed by the peer, or connected without data."""
        if self._hung_up:
            return f"{self._name} closed the connection"
        return (
            f"{self._name} is connected but sends nothing; a simulator serves one client at a time: is "
            "another one connected?"
        )

    def close(self) -> None:
        """Closes the connection."""
        if self._task is not None:
            self._task.cancel()
        if self._connection is not None:
            self._connection.close()


class _Connection(asyncio.Protocol):
    """One connection; `address` is that of its peer."""

    def __init__(self, on_data: OnData) -> None:
        self._on_data = on_data
        self._transport: asyncio.Transport | None = None
        self._lost = asyncio.Event()
        self._reason = "the peer has closed the connection"
        self._last_received = asyncio.get_running_loop().time()
        self._has_received = False
        self.address = ""

    @property
    def is_lost(self) -> bool:
        """Whether the peer or the system has closed the connection."""
        return self._lost.is_set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Stores the transport of the open connection."""
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is no subclass of it

    def data_received(self, data: bytes) -> None:
        """Handles bytes of the stream."""
        self._last_received, self._has_received = asyncio.get_running_loop().time(), True
        self._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Records the end of the connection and its reason."""
        if exc is not None:
            self._reason = reason_of(exc)
        self._lost.set()

    async def until_lost(self, attempts: Attempts) -> str:
        """Waits until the connection is closed, or SILENT seconds without data; returns the reason."""
        loop = asyncio.get_running_loop()
        while not self.is_lost:
            remaining = self._last_received + SILENT - loop.time()
            if remaining <= 0.0:
                return f"no data for {SILENT:g} s"
            with suppress(TimeoutError):
                async with asyncio.timeout(remaining):
                    await self._lost.wait()
            if self._has_received:
                attempts.works()
        return self._reason

    def write(self, data: bytes) -> None:
        """Sends bytes, unless too many are queued."""
        transport = self._transport
        if transport is not None and not self.is_lost and transport.get_write_buffer_size() <= BACKLOG:
            transport.write(data)

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    def abort(self) -> None:
        """Aborts the connection; queued data is lost."""
        if self._transport is not None:
            self._transport.abort()
