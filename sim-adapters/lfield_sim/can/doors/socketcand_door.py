"""Clients of socketcand over TCP."""

from __future__ import annotations

import asyncio

from lfield.errors import AddressError
from lfield_sim.can.bus import Frame, Port
from lfield_sim.can.doors import socketcand
from lfield_sim.can.doors.hub import MOST_WAITING, Hub
from lfield_sim.can.doors.socketcand import GREETING, Socketcand

CHANNEL = "can0"
#: A client that leaves more than this unread is dropped, in bytes.
MOST_UNREAD = 1 << 20
#: python-can takes what comes after `< rawmode >` in one piece and wants `< ok >` alone in it: a client that
#: has said nothing since gets its first frames this much later, in seconds.
HOLD = 0.1


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
        place, number = self._listener.sockets[0].getsockname()[:2]
        self._address = f"{place}:{number}"

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
