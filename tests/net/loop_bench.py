"""Benches of the transport kit on event loops of their own."""

import asyncio

from lfield.net.tcp_transport import TcpTransport
from lfield.testing.transport_kit import MAX_BLOCK

TIMEOUT = 60.0


class LoopBench:
    """Transports in an event loop of their own; what the tests leave open is closed."""

    #: Seconds between two checks of a condition.
    interval = 0.0

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.loop = loop
        self.transport = self
        self.links, self.listeners = [], []

    async def listen_with(self, transport, address: str, on_link):
        def tracked(link):
            self.links.append(link)
            return on_link(link)

        self.listeners.append(await transport.listen(address, tracked))
        return self.listeners[-1]

    async def connect_with(self, transport, address: str, handler):
        self.links.append(await transport.connect(address, handler))
        return self.links[-1]

    def wait(self, work):
        return self.loop.run_until_complete(work)

    def until(self, done) -> None:
        async def poll() -> None:
            async with asyncio.timeout(TIMEOUT):
                while not done():
                    await asyncio.sleep(self.interval)

        self.wait(poll())

    def write(self, link, data: bytes) -> None:
        link.write(data)

    def close(self, *transports) -> None:
        for opened in self.listeners + self.links:
            opened.close()
        self.until(lambda: all(len(link.handler.ends) == 1 for link in self.links))
        for transport in transports:
            transport.close()
        self.loop.close()


class TcpBench(LoopBench):
    """TCP on loopback."""

    address = "127.0.0.1:0"

    def __init__(self, loop: asyncio.AbstractEventLoop, **options) -> None:
        super().__init__(loop)
        self.tcp = TcpTransport(MAX_BLOCK, **options)

    async def listen(self, address: str, on_link):
        return await self.listen_with(self.tcp, address, on_link)

    async def connect(self, address: str, handler, host=""):
        return await self.connect_with(self.tcp, address, handler)
