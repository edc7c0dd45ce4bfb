"""Routers that change data: a relay that changes bytes in transit, and a participant that injects packets."""

import asyncio
import json
import threading

import zenoh

from lfield.net.zenoh.endpoint import ROOT
from lfield.net.zenoh.packets import Kind, Packet, decode_packet


class ChangingRelay:
    """Relays TCP to a router. While `is_lying`, one byte in the middle of each long read is changed."""

    def __init__(self, endpoint: str) -> None:
        host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
        self._there = (host, int(port))
        self.is_lying, self.changed = False, 0
        self.endpoint = ""
        self._server: asyncio.Server | None = None
        self._tasks: list[asyncio.Task] = []

    async def open(self) -> None:
        """Listen on a free port."""
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.endpoint = f"tcp/127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def close(self) -> None:
        """End all connections."""
        self._server.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.sleep(0.05)

    async def _serve(self, reader, writer) -> None:
        self._tasks.append(asyncio.current_task())
        there = await asyncio.open_connection(*self._there)
        try:
            await asyncio.gather(self._copy(reader, there[1]), self._copy(there[0], writer))
        finally:
            there[1].close()
            writer.close()

    async def _copy(self, reader, writer) -> None:
        while data := await reader.read(1 << 16):
            if self.is_lying and len(data) > 2000:
                middle = len(data) // 2
                data = data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]
                self.changed += 1
            writer.write(data)
            await writer.drain()


class Injector:
    """Reads all packets of a fabric, and sends others with the same keys."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        for key, value in (("mode", "client"), ("connect/endpoints", [endpoint])):
            config.insert_json5(key, json.dumps(value))
        config.insert_json5("scouting/multicast/enabled", "false")
        self._session = zenoh.open(config)
        self._lock = threading.Lock()
        #: The last packet of each key with data.
        self._last: dict[str, Packet] = {}
        self._subscriber = self._session.declare_subscriber(f"{ROOT}/to/**", self._read)

    def _read(self, sample) -> None:
        packet = decode_packet(sample.payload.to_bytes())
        if packet is not None and packet.kind is Kind.DATA:
            with self._lock:
                self._last[str(sample.key_expr)] = packet

    @property
    def packets(self) -> dict[str, Packet]:
        """The last packet of each key with data."""
        with self._lock:
            return dict(self._last)

    def inject(self, kind: Kind, data: bytes = b"") -> None:
        """Send a packet to every receiver, with the number that it expects next."""
        for key, packet in self.packets.items():
            forged = Packet(kind, packet.number + 1, packet.expected, packet.unread, data)
            self._session.put(key, forged.encode())

    def close(self) -> None:
        """Leave the fabric."""
        self._session.close()
