"""Routers as processes on loopback, and a bench of the transport kit over them."""

import asyncio
import socket
import subprocess
import sys
from pathlib import Path

from lfield.authority.identity import ANONYMOUS
from lfield.net.tcp_transport import TcpTransport
from lfield.net.zenoh.config import ZenohConfig
from lfield.net.zenoh.transport import ZenohTransport
from lfield.testing.transport_kit import MAX_BLOCK

PATIENCE = 60.0
ROUTER = Path(__file__).with_name("router_process.py")


def free_endpoint() -> str:
    """An endpoint on loopback whose port was free."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


class Router:
    """A router that may be killed and started again at the same endpoint."""

    def __init__(self, *connect: str, endpoint: str = "", python: str = sys.executable) -> None:
        self._connect, self._python = connect, python
        self.endpoint = endpoint
        self.process: subprocess.Popen[str] | None = None
        self.start()

    def start(self) -> None:
        """Start it; the first time, choose ports until one is free."""
        fixed = self.endpoint
        for _ in range(10):
            self.endpoint = fixed or free_endpoint()
            command = [self._python, str(ROUTER), self.endpoint, *self._connect]
            self.process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )
            assert self.process.stdout is not None
            if self.process.stdout.readline() == "ready\n":
                return
            self.kill()
        raise AssertionError("no router starts")

    def kill(self) -> None:
        """Kill it."""
        assert self.process is not None
        assert self.process.stdout is not None
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def running_router():
    """A fixture: a router that is killed at the end."""
    router = Router()
    yield router
    router.kill()


class ZenohBench:
    """Two transports with a session each; `near` dials, `far` listens."""

    address = "zenoh:alpha:0"

    def __init__(self, near: ZenohConfig, far: ZenohConfig, timeout: float = 5.0, **options) -> None:
        self.loop = asyncio.new_event_loop()
        links = TcpTransport(MAX_BLOCK, **options)
        self.near, self.far = (ZenohTransport(config, links.new_link, timeout) for config in (near, far))
        self.transport, self._is_tls = self, "tls" in options
        self.links, self.listeners, self.notes = [], [], []
        for transport in (self.near, self.far):
            transport.log_to(self.notes.append)

    async def listen(self, address: str, on_link):
        def tracked(link):
            self.links.append(link)
            return on_link(link)

        self.listeners.append(await self.far.listen(address, tracked))
        return self.listeners[-1]

    async def connect(self, address: str, handler, host=""):
        link = await self.near.connect(address, handler)
        self.links.append(link)
        # The kit sends at both ends at once; before its handshake the accepting end of TLS sends nothing.
        while self._is_tls and any(each.who == ANONYMOUS and not each.closed for each in self.links):
            await asyncio.sleep(0.0005)
        return link

    def wait(self, work):
        return self.loop.run_until_complete(work)

    def until(self, done) -> None:
        async def poll() -> None:
            async with asyncio.timeout(PATIENCE):
                while not done():
                    await asyncio.sleep(0.0005)

        self.wait(poll())

    def write(self, link, data: bytes) -> None:
        link.write(data)

    def close(self) -> None:
        for opened in self.listeners + self.links:
            opened.close()
        self.until(lambda: all(len(link.handler.ends) == 1 for link in self.links))
        self.near.close()
        self.far.close()
        self.loop.close()
