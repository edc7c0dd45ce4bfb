"""How clients reach the bus: socketcand clients over TCP, and one slcan dongle on a pty."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import tty
from collections.abc import Callable
from typing import Protocol

from lfield.errors import AddressError
from lfield_sim.can import slcan, socketcand
from lfield_sim.can.bus import BUS_OFF, Port
from lfield_sim.can.frame import Frame
from lfield_sim.can.slcan import Slcan
from lfield_sim.can.socketcand import GREETING, Socketcand

CHANNEL = "can0"
#: Frames of one client that may wait for the bus before no more is read from it.
MOST_WAITING = 64
#: A TCP client that leaves more than this unread is dropped, and a dongle loses lines, in bytes.
MOST_UNREAD, MOST_UNREAD_SERIAL = 1 << 20, 1 << 16
#: python-can takes what comes after `< rawmode >` in one piece and wants `< ok >` alone in it: a client that
#: has said nothing since gets its first frames this much later, in seconds.
HOLD = 0.1


class Hub(Protocol):
    """What a door needs of the server."""

    def join(self, port: Port) -> None:
        """Let a port take part."""

    def leave(self, port: Port) -> None:
        """Let it go."""

    def send(self, port: Port, frame: Frame) -> None:
        """Put a frame on the bus now."""

    def when_sent(self, go_on: Callable[[], None]) -> None:
        """Call once after the bus has moved on."""

    def seconds(self, time: float) -> float:
        """A time of the bus as a time of day."""

    def is_off(self, port: Port) -> bool:
        """Whether a port is bus-off."""


class Door(Protocol):
    """A way to the bus that can be pulled out and plugged in again (the fault `unplug`)."""

    plugged: bool

    @property
    def endpoint(self) -> str:
        """As a binding has it."""

    def plug(self) -> None:
        """Let clients in."""

    def unplug(self) -> None:
        """Throw clients out."""

    def close(self) -> None:
        """The end."""


class SocketcandDoor:
    """A server of socketcand."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self.plugged = False
        self._clients: set[asyncio.Transport] = set()

    async def listen(self, host: str, port: int) -> None:
        """Take a port; 0 is any free one. Raises AddressError."""
        try:
            self._listener = await asyncio.get_running_loop().create_server(self._client, host, port)
        except OSError as error:
            raise AddressError(f"socketcand:{host}:{port}", error.strerror or str(error)) from None
        self._address = f"{host}:{self._listener.sockets[0].getsockname()[1]}"

    @property
    def endpoint(self) -> str:
        """As a binding has it."""
        return f"socketcand:{self._address}/{CHANNEL}"

    def came(self, transport: asyncio.Transport) -> bool:
        """Whether a new client is let in."""
        if self.plugged:
            self._clients.add(transport)
        else:
            transport.abort()
        return self.plugged

    def went(self, transport: asyncio.Transport) -> None:
        """A client is gone."""
        self._clients.discard(transport)

    def plug(self) -> None:
        """Let clients in."""
        self.plugged = True

    def unplug(self) -> None:
        """Throw clients out; new ones are dropped as soon as they come."""
        self.plugged = False
        for transport in list(self._clients):
            transport.abort()

    def close(self) -> None:
        """Listen no more."""
        self.unplug()
        self._listener.close()

    def _client(self) -> SocketcandClient:
        return SocketcandClient(self._hub, self)


class SocketcandClient(asyncio.Protocol):
    """One client of socketcand."""

    def __init__(self, hub: Hub, door: SocketcandDoor) -> None:
        self._hub, self._door, self._protocol = hub, door, Socketcand(CHANNEL)
        self._buffer = bytearray()
        self._port = Port(self._hear)
        self._held: bytearray | None = None
        self._closed = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Greet."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if self._door.came(transport):
            transport.write(GREETING)

    def data_received(self, data: bytes) -> None:
        """Carry out what has come."""
        self._buffer += data
        self._pump()

    def connection_lost(self, exc: Exception | None) -> None:
        """Leave the bus."""
        self._closed = True
        self._door.went(self._transport)
        if self._protocol.raw:
            self._hub.leave(self._port)

    def _pump(self) -> None:
        while not self._closed and self._port.waiting < MOST_WAITING:
            text = socketcand.cut(self._buffer)
            if text is None:
                self._transport.resume_reading()
                return
            self._carry_out(text)
        if not self._closed:
            self._transport.pause_reading()
            self._hub.when_sent(self._pump)

    def _carry_out(self, text: bytes) -> None:
        was_raw = self._protocol.raw
        answer, frame = self._protocol.command(text)
        if answer:
            self._transport.write(answer)
        if self._protocol.raw and not was_raw:
            self._held = bytearray()
            self._hub.join(self._port)
            asyncio.get_running_loop().call_later(HOLD, self._release)
        if frame:
            self._release()
            self._hub.send(self._port, frame)

    def _release(self) -> None:
        """Send what was held back."""
        held, self._held = self._held, None
        if held and not self._closed:
            self._transport.write(held)

    def _hear(self, frame: Frame, time: float) -> None:
        text = self._protocol.encode(frame, self._hub.seconds(time))
        if self._held is not None:
            self._held += text
        elif self._transport.get_write_buffer_size() > MOST_UNREAD:
            self._transport.abort()
        elif not self._transport.is_closing():
            self._transport.write(text)


class SlcanDoor:
    """A dongle on a pty, at a symbolic link if one is wanted (its name stays when it is plugged in again)."""

    def __init__(self, hub: Hub, link: str = "") -> None:
        self._hub, self._link = hub, link
        self._loop = asyncio.get_running_loop()
        self.plugged = False

    @property
    def endpoint(self) -> str:
        """As a binding has it."""
        return f"slcan:{self._link or self._path}@115200"

    def plug(self) -> None:
        """A dongle that has just got its power. Raises AddressError when the link cannot be made."""
        # The slave stays open here, so that clients may come and go.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path = os.ttyname(self._slave)
        self.plugged = True
        self._buffer, self._unsent = bytearray(), bytearray()
        port = self._port = Port(self._hear)
        self._protocol = Slcan(lambda: BUS_OFF if self._hub.is_off(port) else port.errors)
        self._hub.join(port)
        self._loop.add_reader(self._master, self._readable)
        if self._link:
            _link(self._link, self._path)

    def unplug(self) -> None:
        """Pull it out: whoever has it open gets an error."""
        if not self.plugged:
            return
        self.plugged = False
        self._hub.leave(self._port)
        self._loop.remove_reader(self._master)
        self._loop.remove_writer(self._master)
        os.close(self._master)
        os.close(self._slave)
        if self._link and os.path.islink(self._link):
            os.unlink(self._link)

    def close(self) -> None:
        """The end."""
        self.unplug()

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._buffer += os.read(self._master, 4096)
        self._pump()

    def _pump(self) -> None:
        while self.plugged and self._port.waiting < MOST_WAITING:
            text = slcan.cut(self._buffer)
            if text is None:
                self._loop.add_reader(self._master, self._readable)
                return
            answer, frame = self._protocol.command(text)
            self._port.bitrate = self._protocol.bitrate
            self._write(answer)
            if frame:
                self._hub.send(self._port, frame)
        if self.plugged:
            self._loop.remove_reader(self._master)
            self._hub.when_sent(self._pump)

    def _hear(self, frame: Frame, _: float) -> None:
        if self._protocol.opened:
            self._write(self._protocol.encode(frame))

    def _write(self, data: bytes) -> None:
        """Whole lines or nothing: what nobody reads is lost, as in a dongle."""
        if len(self._unsent) > MOST_UNREAD_SERIAL:
            return
        self._unsent += data
        self._flush()

    def _flush(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._unsent:
                del self._unsent[: os.write(self._master, self._unsent)]
        if self._unsent:
            self._loop.add_writer(self._master, self._flush)
        else:
            self._loop.remove_writer(self._master)


def _link(link: str, path: str) -> None:
    """Let a symbolic link lead to a path. Raises AddressError."""
    try:
        if os.path.islink(link):
            os.unlink(link)
        os.symlink(path, link)
    except OSError as error:
        raise AddressError(link, error.strerror or str(error)) from None
