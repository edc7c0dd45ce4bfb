"""A listener as a process that a test stops: `python stopped_peer.py ENDPOINT`. Prints its address."""

import asyncio
import sys

from lfield.net.tcp_transport import TcpTransport
from lfield.net.zenoh.config import ZenohConfig
from lfield.net.zenoh.transport import ZenohTransport
from lfield.testing.transport_kit import MAX_BLOCK, Recorder


async def serve() -> None:
    transport = ZenohTransport(ZenohConfig((sys.argv[1],)), TcpTransport(MAX_BLOCK).new_link)

    def on_link(link):
        link.accept_role("host")
        return Recorder()

    listener = await transport.listen("zenoh:alpha:0", on_link)
    print(listener.address, flush=True)
    await asyncio.get_running_loop().create_future()


if __name__ == "__main__":
    asyncio.run(serve())
