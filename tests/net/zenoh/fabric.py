"""Routers as processes on loopback, and a bench of the transport kit over them."""

import asyncio
import socket
import subprocess
import sys
from pathlib import Path

from loop_bench import LoopBench

from lfield.authority.identity import ANONYMOUS
from lfield.net.tcp_transport import TcpTransport
from lfield.net.zenoh.config import ZenohConfig
from lfield.net.zenoh.transport import ZenohTransport
from lfield.testing.transport_kit import MAX_BLOCK

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


class ZenohBench(LoopBench):
    """Two transports with a session each; `near` dials, `far` listens."""

    address, interval = "zenoh:alpha:0", 0.0005

    def __init__(self, near: ZenohConfig, far: ZenohConfig, timeout: float = 5.0, **options) -> None:
        super().__init__(asyncio.new_event_loop())
        links = TcpTransport(MAX_BLOCK, **options)
        self.near, self.far = (ZenohTransport(config, links.new_link, timeout) for config in (near, far))
        self._is_tls, self.notes = "tls" in options, []
        for transport in (self.near, self.far):
            transport.log_to(self.notes.append)

    async def listen(self, address: str, on_link):
        return await self.listen_with(self.far, address, on_link)

    async def connect(self, address: str, handler, host=""):
        link = await self.connect_with(self.near, address, handler)
        # The kit sends at both ends at once; before its handshake the accepting end of TLS sends nothing.
        while self._is_tls and any(each.identity == ANONYMOUS and not each.closed for each in self.links):
            await asyncio.sleep(self.interval)
        return link

    def close(self) -> None:
        super().close(self.near, self.far)
