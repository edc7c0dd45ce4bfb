"""Names and silent addresses on loopback, and listeners for tests of host addresses."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable

import pytest

from lfield.net.tcp_transport import TcpTransport
from lfield.testing.transport_kit import MAX_BLOCK, Recorder

#: The backlog of this listener is full: a connection attempt gets no answer.
HOLE = "127.0.0.9"


def has_ipv6() -> bool:
    try:
        with socket.create_server(("::1", 0), family=socket.AF_INET6):
            return True
    except OSError:
        return False


needs_ipv6 = pytest.mark.skipif(not has_ipv6(), reason="this computer has no IPv6")


class NameTable:
    """The addresses of host names, in place of the system's resolver."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.rows: dict[str, list[str]] = {}
        self.blocked = threading.Event()
        self.blocking: set[str] = set()
        self.asked = 0
        self._real = socket.getaddrinfo
        monkeypatch.setattr(socket, "getaddrinfo", self._found)

    def _found(self, host, port, *args, flags=0, **more):
        if flags & socket.AI_NUMERICHOST or host not in self.rows:
            return self._real(host, port, *args, flags=flags, **more)
        self.asked += 1
        if host in self.blocking:
            self.blocked.wait(30.0)
        return [row for address in self.rows[host] for row in self._real(address, port, *args, **more)]


async def listening(address: str, transport: TcpTransport | None = None):
    accepted: list[Recorder] = []

    def on_link(link):
        accepted.append(Recorder())
        return accepted[-1]

    found = await (transport or TcpTransport(MAX_BLOCK)).listen(address, on_link)
    return found, accepted


async def until(done: Callable[[], bool]) -> None:
    async with asyncio.timeout(30.0):
        while not done():
            await asyncio.sleep(0.01)
