"""Serves vehicles over UDP, TCP or a pty in real time."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable, Hashable
from typing import Any, Protocol

from lfield.errors import AddressError
from lfield.event_loop import SimulatedLoop
from lfield_sim.mavlink.mavlink_fake import MavlinkLink

#: Seconds between two steps of the model and of sending.
TICK = 0.02
#: Maximum catch-up of the model after a pause of the process, in seconds.
LONGEST_TICK = 1.0
#: Peers at most; the one that was silent longest is removed.
MAX_PEERS = 16
#: Bytes queued for a slow reader; more is dropped, as on a radio.
MAX_WAITING = 1 << 16
#: The baud rate in the endpoint of a pty, which has none of its own.
BAUD = 57600

SendPacket = Callable[[bytes], None]


class LinkServer:
    """The link and its peers; a peer is identified by the function that sends to it.

    `on_change` is called whenever a vehicle may have changed.
    """

    def __init__(self, link: MavlinkLink, on_change: Callable[[], None] = lambda: None) -> None:
        self._link, self._on_change = link, on_change
        self._loop = asyncio.get_running_loop()
        self._last = self._loop.time()
        self.peers: dict[Hashable, SendPacket] = {}

    def received(self, peer: Hashable, send: SendPacket, data: bytes, *, local: bool = False) -> None:
        """Handles bytes from a peer; only this peer gets the answers."""
        self.peers.pop(peer, None)
        self.peers[peer] = send
        while len(self.peers) > MAX_PEERS:
            del self.peers[next(iter(self.peers))]
        packets = self._link.receive(peer, data, local=local)
        self._on_change()
        for packet in packets:
            send(packet)

    async def tick(self) -> None:
        """Advances the model with the clock, and sends to every peer, until cancelled."""
        while True:
            await asyncio.sleep(TICK)
            now = self._loop.time()
            packets = self._link.advance(min(now - self._last, LONGEST_TICK))
            self._last = now
            self._on_change()
            for send in list(self.peers.values()):
                for packet in packets:
                    send(packet)


class LinkEndpoint(Protocol):
    """Accepts peers. `endpoint` is as in a binding."""

    endpoint: str

    def close(self) -> None:
        """Stops accepting peers."""


class UdpEndpoint(asyncio.DatagramProtocol):
    """Datagrams; a peer is an address."""

    def __init__(self, server: LinkServer) -> None:
        self._server = server
        self.endpoint = ""

    def connection_made(self, transport: Any) -> None:
        """Stores the transport of the bound socket."""
        self._transport = transport
        host, port = transport.get_extra_info("sockname")[:2]
        self.endpoint = f"udp:{host}:{port}"

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Handles a packet of a peer."""
        self._server.received(addr, lambda packet: self._transport.sendto(packet, addr), data)

    def error_received(self, exc: Exception) -> None:
        """Ignores "port unreachable" of a closed peer, which is removed when newer peers exceed MAX_PEERS."""

    def close(self) -> None:
        """Closes the socket."""
        self._transport.close()


class TcpEndpoint:
    """Connections; each is a peer."""

    def __init__(self, listener: asyncio.Server) -> None:
        self._listener = listener
        host, port = listener.sockets[0].getsockname()[:2]
        self.endpoint = f"tcp:{host}:{port}"

    def close(self) -> None:
        """Stops listening."""
        self._listener.close()


class _Connection(asyncio.Protocol):
    def __init__(self, server: LinkServer) -> None:
        self._server = server

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._server.peers[self] = self._send

    def data_received(self, data: bytes) -> None:
        self._server.received(self, self._send, data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.peers.pop(self, None)

    def _send(self, packet: bytes) -> None:
        if self._transport.get_write_buffer_size() < MAX_WAITING:
            self._transport.write(packet)


class PtyEndpoint:
    """A serial line: one peer, any process that has the other end open. It is local (channel 0)."""

    def __init__(self, server: LinkServer) -> None:
        self._server = server
        # Our descriptor of the slave stays open: without one, reading the master is an error.
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.endpoint = f"serial:{os.ttyname(self._slave)}:{BAUD}"
        self._waiting = b""
        asyncio.get_running_loop().add_reader(self._master, self._readable)
        server.peers[self] = self._send

    def _readable(self) -> None:
        self._server.received(self, self._send, os.read(self._master, 4096), local=True)

    def _send(self, packet: bytes) -> None:
        if len(self._waiting) < MAX_WAITING:
            self._waiting += packet
        try:
            self._waiting = self._waiting[os.write(self._master, self._waiting) :]
        except BlockingIOError:
            # No reader; the next packet tries again.
            return

    def close(self) -> None:
        """Closes the line."""
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)


async def open_endpoint(server: LinkServer, transport: str, host: str, port: int) -> LinkEndpoint:
    """Opens an endpoint: `udp`, `tcp`, or `pty`, which has no address. Raises AddressError."""
    loop = asyncio.get_running_loop()
    try:
        if transport == "pty":
            return PtyEndpoint(server)
        if transport == "tcp" or isinstance(loop, SimulatedLoop):
            return TcpEndpoint(await loop.create_server(lambda: _Connection(server), host, port))
        _, endpoint = await loop.create_datagram_endpoint(lambda: UdpEndpoint(server), (host, port))
        return endpoint
    except OSError as error:
        raise AddressError(f"{transport}:{host}:{port}", error.strerror or str(error)) from None
