"""Serves a fake over UDP or TCP in real time, until it is told to end."""

from __future__ import annotations

import asyncio
import signal
import sys
from typing import Any

from lfield.errors import AddressError
from lfield_sim.mavlink.protocol import MavlinkFake

#: How often the model moves and packets are sent, in seconds.
TICK = 0.02


class _Server:
    """Peers and the fake; a peer is anything with `send`."""

    def __init__(self, fake: MavlinkFake) -> None:
        self._fake = fake
        self._loop = asyncio.get_running_loop()
        self._last = self._loop.time()
        self.peers: dict[Any, Any] = {}

    def received(self, peer: Any, send: Any, data: bytes) -> None:
        """Bytes from a peer; answers go back to it alone."""
        self.peers[peer] = send
        while len(self.peers) > 16:
            del self.peers[next(iter(self.peers))]
        for packet in self._fake.receive(peer, data):
            send(packet)

    def tick(self) -> None:
        """Move the model to the present, and send what is due to every peer."""
        now = self._loop.time()
        packets = self._fake.advance(now - self._last)
        self._last = now
        for send in list(self.peers.values()):
            for packet in packets:
                send(packet)


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, server: _Server) -> None:
        self._server = server

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._server.received(addr, lambda packet: self._transport.sendto(packet, addr), data)

    def error_received(self, exc: Exception) -> None:
        # A peer that has gone answers with "port unreachable"; it is forgotten when others come.
        pass


class _Stream(asyncio.Protocol):
    def __init__(self, server: _Server) -> None:
        self._server = server

    def connection_made(self, transport: Any) -> None:
        self._transport = transport
        self._server.peers[self] = transport.write

    def data_received(self, data: bytes) -> None:
        self._server.received(self, self._transport.write, data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.peers.pop(self, None)


async def serve(
    fake: MavlinkFake, transport: str, host: str, port: int, words: str, *, until_stdin_closes: bool
) -> int:
    """Listen, print `ready TRANSPORT:HOST:PORT WORDS`, and serve. Raises AddressError."""
    loop = asyncio.get_running_loop()
    server = _Server(fake)
    try:
        if transport == "udp":
            endpoint, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(server), (host, port))
            bound, close = endpoint.get_extra_info("sockname")[1], endpoint.close
        else:
            listener = await loop.create_server(lambda: _Stream(server), host, port)
            bound, close = listener.sockets[0].getsockname()[1], listener.close
    except OSError as error:
        raise AddressError(f"{transport}:{host}:{port}", error.strerror or str(error)) from None
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    if until_stdin_closes:
        await loop.connect_read_pipe(lambda: _UntilEnd(stop), sys.stdin)
    print(f"ready {transport}:{host}:{bound} {words}", flush=True)
    ticking = loop.create_task(_tick(server))
    await stop.wait()
    ticking.cancel()
    close()
    return 0


async def _tick(server: _Server) -> None:
    while True:
        await asyncio.sleep(TICK)
        server.tick()


class _UntilEnd(asyncio.Protocol):
    """Sets an event when its pipe closes."""

    def __init__(self, ended: asyncio.Event) -> None:
        self._ended = ended

    def eof_received(self) -> None:
        self._ended.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self._ended.set()
