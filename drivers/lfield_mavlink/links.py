"""Endpoints and the links behind them: UDP, TCP and serial. Bytes only.

udp:HOST:PORT         sends to a vehicle that listens there
udpin:HOST:PORT       listens there for a vehicle that sends (answers go to whoever sent last)
tcp:HOST:PORT         connects; reconnects when the connection breaks
serial:/dev/ttyX:BAUD a serial port, 8N1; reopened when it was unplugged
"""

from __future__ import annotations

import asyncio
import fcntl
import os
import termios
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from lfield.errors import DeviceError

#: Seconds between attempts to open a link again.
AGAIN = 1.0
SYNTAX = "udp:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:/dev/ttyX:BAUD"

OnData = Callable[[bytes], None]


class Link(Protocol):
    """One open endpoint."""

    async def open(self) -> None:
        """Open it. Raises DeviceError when that is impossible here and now."""

    def send(self, data: bytes) -> None:
        """Send one packet; what cannot be sent is lost, as on a radio."""

    def close(self) -> None:
        """Give it back."""


def make_link(endpoint: str, on_data: OnData) -> Link:
    """The link of an endpoint, not open yet. Raises DeviceError with a sentence on how to write one."""
    kind, _, rest = endpoint.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in ("udp", "udpin", "tcp", "serial") or not place or not number.isdecimal():
        raise DeviceError("endpoint", f"'{endpoint}' is not an endpoint; write {SYNTAX}")
    if kind == "serial":
        return SerialLink(place, int(number), on_data)
    if not 0 < int(number) < 65536:
        raise DeviceError("endpoint", f"'{endpoint}' has no port from 1 to 65535")
    if kind == "tcp":
        return TcpLink(place, int(number), on_data)
    return UdpLink(place, int(number), on_data, listens=kind == "udpin")


class UdpLink(asyncio.DatagramProtocol):
    """Datagrams to one peer: the one we were told, or the one we heard last."""

    def __init__(self, host: str, port: int, on_data: OnData, *, listens: bool) -> None:
        self._address, self._on_data, self._listens = (host, port), on_data, listens
        self._transport: asyncio.DatagramTransport | None = None
        self._peer: tuple[str, int] | None = None

    async def open(self) -> None:
        """Bind or connect the socket."""
        local, remote = (self._address, None) if self._listens else (None, self._address)
        try:
            loop = asyncio.get_running_loop()
            transport, _ = await loop.create_datagram_endpoint(lambda: self, local, remote)
        except OSError as error:
            raise _cannot("udp", self._address, error) from None
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """A packet from a vehicle."""
        if self._listens:
            self._peer = addr
        self._on_data(data)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet; the heartbeat says when somebody does."""

    def send(self, data: bytes) -> None:
        """To the peer, if there is one."""
        if self._transport is not None and (self._peer or not self._listens):
            self._transport.sendto(data, self._peer)

    def close(self) -> None:
        """Close the socket."""
        if self._transport is not None:
            self._transport.close()


class TcpLink(asyncio.Protocol):
    """A connection that comes back."""

    def __init__(self, host: str, port: int, on_data: OnData) -> None:
        self._address, self._on_data = (host, port), on_data
        self._transport: asyncio.WriteTransport | None = None
        self._task: asyncio.Task[None] | None = None
        self._closed = False

    async def open(self) -> None:
        """Connect, now."""
        try:
            await self._connect()
        except OSError as error:
            raise _cannot("tcp", self._address, error) from None

    async def _connect(self) -> None:
        transport, _ = await asyncio.get_running_loop().create_connection(lambda: self, *self._address)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Bytes of the stream."""
        self._on_data(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """Try again until it works or we are closed."""
        self._transport = None
        if not self._closed:
            self._task = asyncio.get_running_loop().create_task(self._reconnect())

    async def _reconnect(self) -> None:
        while self._transport is None:
            await asyncio.sleep(AGAIN)
            try:
                await self._connect()
            except OSError:
                continue

    def send(self, data: bytes) -> None:
        """Into the stream, if there is one."""
        if self._transport is not None:
            self._transport.write(data)

    def close(self) -> None:
        """Hang up."""
        self._closed = True
        if self._task is not None:
            self._task.cancel()
        if self._transport is not None:
            self._transport.close()


class SerialLink:
    """A tty in raw mode, read as it becomes readable. One owner: the port is locked for others."""

    def __init__(self, path: str, baud: int, on_data: OnData) -> None:
        self._path, self._baud, self._on_data = path, baud, on_data
        self._fd: int | None = None
        self._task: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Open and configure the port, now."""
        try:
            self._attach()
        except (OSError, termios.error) as error:
            raise _cannot("serial", (self._path, self._baud), error) from None

    def _attach(self) -> None:
        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            raise OSError(0, f"no serial port has {self._baud} baud")
        fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _set_raw(fd, speed)
        except BaseException:
            os.close(fd)
            raise
        self._fd = fd
        asyncio.get_running_loop().add_reader(fd, self._readable)

    def _readable(self) -> None:
        assert self._fd is not None
        try:
            data = os.read(self._fd, 4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._on_data(data)
            return
        self._detach()
        self._task = asyncio.get_running_loop().create_task(self._reattach())

    async def _reattach(self) -> None:
        while self._fd is None:
            await asyncio.sleep(AGAIN)
            try:
                self._attach()
            except (OSError, termios.error):
                continue

    def _detach(self) -> None:
        if self._fd is not None:
            asyncio.get_running_loop().remove_reader(self._fd)
            os.close(self._fd)
            self._fd = None

    def send(self, data: bytes) -> None:
        """Into the port; when its buffer is full the packet is lost, which MAVLink survives."""
        if self._fd is not None:
            with suppress(OSError):
                os.write(self._fd, data)

    def close(self) -> None:
        """Give the port back."""
        if self._task is not None:
            self._task.cancel()
        self._detach()


def _set_raw(fd: int, speed: int) -> None:
    """8 data bits, no parity, no flow control, no translation of bytes."""
    attributes = termios.tcgetattr(fd)
    attributes[0] = attributes[1] = attributes[3] = 0
    attributes[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    attributes[4] = attributes[5] = speed
    termios.tcsetattr(fd, termios.TCSANOW, attributes)


def _cannot(kind: str, address: tuple[str, int], error: Exception) -> DeviceError:
    reason = getattr(error, "strerror", None) or str(error)
    return DeviceError("endpoint", f"cannot open {kind}:{address[0]}:{address[1]}: {reason}")
