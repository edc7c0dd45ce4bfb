"""Serves vehicles over UDP, TCP or a pty in real time."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import Callable, Hashable
from typing import Any, Protocol

from lfield.errors import AddressError
from lfield.loop import Simulated
from lfield_sim.mavlink.protocol import MavlinkLink

#: How often the model moves and packets are sent, in seconds.
TICK = 0.02
#: After a pause of the process (s) the model does not catch up with more than this.
LONGEST_TICK = 1.0
#: Peers that are sent to at most; the one that was silent longest is forgotten.
MAX_PEERS = 16
#: Bytes that wait for a slow reader at most; what is more is lost, as on a radio.
MAX_WAITING = 1 << 16
#: The baud rate of the pty in its endpoint; a pty has none of its own.
BAUD = 57600

Send = Callable[[bytes], None]


class Server:
    """The link and its peers, by whatever tells them apart; a peer is known by how it is sent to.

    `moved` is called whenever a vehicle may have changed.
    """

    def __init__(self, link: MavlinkLink, moved: Callable[[], None] = lambda: None) -> None:
        self._link, self._moved = link, moved
        self._loop = asyncio.get_running_loop()
        self._last = self._loop.time()
        self.peers: dict[Hashable, Send] = {}

    def received(self, peer: Hashable, send: Send, data: bytes, *, local: bool = False) -> None:
        """Bytes from a peer; answers go back to it alone."""
        self.peers.pop(peer, None)
        self.peers[peer] = send
        while len(self.peers) > MAX_PEERS:
            del self.peers[next(iter(self.peers))]
        packets = self._link.receive(peer, data, local=local)
        self._moved()
        for packet in packets:
            send(packet)

    async def tick(self) -> None:
        """Move the model with the clock, and send what is due to every peer, until cancelled."""
        while True:
            await asyncio.sleep(TICK)
            now = self._loop.time()
            packets = self._link.advance(min(now - self._last, LONGEST_TICK))
            self._last = now
            self._moved()
            for send in list(self.peers.values()):
                for packet in packets:
                    send(packet)


class Door(Protocol):
    """Where peers come in. `endpoint` is as a binding would have it."""

    endpoint: str

    def close(self) -> None:
        """Let nobody in any more."""


class UdpDoor(asyncio.DatagramProtocol):
    """Datagrams; a peer is an address."""

    def __init__(self, server: Server) -> None:
        self._server = server
        self.endpoint = ""

    def connection_made(self, transport: Any) -> None:
        """It is bound."""
        self._transport = transport
        host, port = transport.get_extra_info("sockname")[:2]
        self.endpoint = f"udp:{host}:{port}"

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """A packet of a peer."""
        self._server.received(addr, lambda packet: self._transport.sendto(packet, addr), data)

    def error_received(self, exc: Exception) -> None:
        """A peer that has gone answers with "port unreachable"; it is forgotten when others come."""

    def close(self) -> None:
        """Unbind."""
        self._transport.close()


class TcpDoor:
    """Connections; each is a peer."""

    def __init__(self, listener: asyncio.Server) -> None:
        self._listener = listener
        host, port = listener.sockets[0].getsockname()[:2]
        self.endpoint = f"tcp:{host}:{port}"

    def close(self) -> None:
        """Stop listening."""
        self._listener.close()


class _Connection(asyncio.Protocol):
    def __init__(self, server: Server) -> None:
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


class PtyDoor:
    """A serial line: one peer, whoever has the other end open. It is the local one (channel 0)."""

    def __init__(self, server: Server) -> None:
        self._server = server
        # Our own descriptor of the far end stays open: without one, reading ours is an error.
        self._fd, self._far = os.openpty()
        tty.setraw(self._fd)
        tty.setraw(self._far)
        os.set_blocking(self._fd, False)
        self.endpoint = f"serial:{os.ttyname(self._far)}:{BAUD}"
        self._waiting = b""
        asyncio.get_running_loop().add_reader(self._fd, self._readable)
        server.peers[self] = self._send

    def _readable(self) -> None:
        self._server.received(self, self._send, os.read(self._fd, 4096), local=True)

    def _send(self, packet: bytes) -> None:
        if len(self._waiting) < MAX_WAITING:
            self._waiting += packet
        try:
            self._waiting = self._waiting[os.write(self._fd, self._waiting) :]
        except BlockingIOError:
            # Nobody reads; the next packet tries again.
            return

    def close(self) -> None:
        """Take the line away."""
        asyncio.get_running_loop().remove_reader(self._fd)
        os.close(self._fd)
        os.close(self._far)


async def open_door(server: Server, transport: str, host: str, port: int) -> Door:
    """A door of a kind: `udp`, `tcp`, or `pty`, which has no address. Raises AddressError."""
    loop = asyncio.get_running_loop()
    try:
        if transport == "pty":
            return PtyDoor(server)
        if transport == "tcp" or isinstance(loop, Simulated):
            return TcpDoor(await loop.create_server(lambda: _Connection(server), host, port))
        _, door = await loop.create_datagram_endpoint(lambda: UdpDoor(server), (host, port))
        return door
    except OSError as error:
        raise AddressError(f"{transport}:{host}:{port}", error.strerror or str(error)) from None
