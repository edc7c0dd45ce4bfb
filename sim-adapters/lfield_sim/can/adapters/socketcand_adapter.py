"""socketcand server over TCP."""

from __future__ import annotations

import asyncio

from lfield.errors import AddressError
from lfield_sim.can.adapters import socketcand
from lfield_sim.can.adapters.bus_hub import MAX_WAITING, BusHub
from lfield_sim.can.adapters.socketcand import GREETING, SocketcandProtocol
from lfield_sim.can.can_bus import BusPort, CanFrame

CHANNEL = "can0"
#: Unread bytes above which a client is dropped.
MAX_UNREAD = 1 << 20
#: python-can expects `< ok >` alone in the data after `< rawmode >`: a client that has sent nothing since
#: gets its first frames this much later, in seconds.
HOLD = 0.1


class SocketcandAdapter:
    """A server of socketcand."""

    def __init__(self, hub: BusHub) -> None:
        self._hub = hub
        self.plugged = False
        self._clients: set[asyncio.Transport] = set()

    async def listen(self, host: str, port: int) -> None:
        """Listens at a port; 0 is any free one. Raises AddressError."""
        try:
            self._listener = await asyncio.get_running_loop().create_server(self._client, host, port)
        except OSError as error:
            raise AddressError(f"socketcand:{host}:{port}", error.strerror or str(error)) from None
        bound_host, bound_port = self._listener.sockets[0].getsockname()[:2]
        self._address = f"{bound_host}:{bound_port}"

    @property
    def endpoint(self) -> str:
        """The endpoint of the server, as in a binding."""
        return f"socketcand:{self._address}/{CHANNEL}"

    def on_connected(self, transport: asyncio.Transport) -> bool:
        """Whether a new client is accepted."""
        if self.plugged:
            self._clients.add(transport)
        else:
            transport.abort()
        return self.plugged

    def on_disconnected(self, transport: asyncio.Transport) -> None:
        """Removes a client that has disconnected."""
        self._clients.discard(transport)

    def plug(self) -> None:
        """Accepts clients."""
        self.plugged = True

    def unplug(self) -> None:
        """Disconnects clients; new ones are dropped at once."""
        self.plugged = False
        for transport in list(self._clients):
            transport.abort()

    def close(self) -> None:
        """Stops listening."""
        self.unplug()
        self._listener.close()

    def _client(self) -> SocketcandClient:
        return SocketcandClient(self._hub, self)


class SocketcandClient(asyncio.Protocol):
    """One client of socketcand."""

    def __init__(self, hub: BusHub, adapter: SocketcandAdapter) -> None:
        self._hub, self._adapter, self._protocol = hub, adapter, SocketcandProtocol(CHANNEL)
        self._buffer = bytearray()
        self._port = BusPort(self._on_frame)
        self._held_frames: bytearray | None = None
        self._closed = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Sends the greeting."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if self._adapter.on_connected(transport):
            transport.write(GREETING)

    def data_received(self, data: bytes) -> None:
        """Executes received commands."""
        self._buffer += data
        self._pump()

    def connection_lost(self, exc: Exception | None) -> None:
        """Leaves the bus."""
        self._closed = True
        self._adapter.on_disconnected(self._transport)
        if self._protocol.raw:
            self._hub.leave(self._port)

    def _pump(self) -> None:
        while not self._closed and self._port.waiting < MAX_WAITING:
            text = socketcand.next_command(self._buffer)
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
            self._held_frames = bytearray()
            self._hub.join(self._port)
            asyncio.get_running_loop().call_later(HOLD, self._release)
        if frame:
            self._release()
            self._hub.send(self._port, frame)

    def _release(self) -> None:
        """Sends held-back frames."""
        frames, self._held_frames = self._held_frames, None
        if frames and not self._closed:
            self._transport.write(frames)

    def _on_frame(self, frame: CanFrame, time: float) -> None:
        text = self._protocol.encode(frame, self._hub.seconds(time))
        if self._held_frames is not None:
            self._held_frames += text
        elif self._transport.get_write_buffer_size() > MAX_UNREAD:
            self._transport.abort()
        elif not self._transport.is_closing():
            self._transport.write(text)
