"""A proxy for the links of a team that cuts, stalls and heals them; one for each direction."""

from __future__ import annotations

import asyncio
from contextlib import suppress


class LinkProxy:
    """A connection from one host to another: a port of this process that forwards to the other host."""

    def __init__(self, target: int) -> None:
        self._target = target
        self._writers: set[asyncio.StreamWriter] = set()
        self._server: asyncio.Server | None = None
        #: New connections are refused, and existing ones are stalled.
        self._is_cut = False
        self._flows = asyncio.Event()
        self._flows.set()

    async def open(self) -> int:
        """Listen on loopback; returns the port."""
        self._server = await asyncio.start_server(self._called, "127.0.0.1", 0)
        return int(self._server.sockets[0].getsockname()[1])

    def cut(self) -> None:
        """Cut the link: existing and new connections are reset."""
        self._is_cut = True
        for writer in list(self._writers):
            writer.transport.abort()

    def silence(self) -> None:
        """Hold back all bytes in both directions; connections stay open."""
        self._flows.clear()

    def heal(self) -> None:
        """Forward all bytes again, held bytes first."""
        self._is_cut = False
        self._flows.set()

    async def close(self) -> None:
        """Cut the link permanently."""
        self.cut()
        self._flows.set()
        if self._server is not None:
            self._server.close()

    async def _called(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            if self._is_cut:
                return writer.transport.abort()
            await self._flows.wait()
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target)
            ends = {writer, far_writer}
            self._writers |= ends
            try:
                await asyncio.gather(self._pass(reader, far_writer), self._pass(far_reader, writer))
            finally:
                self._writers -= ends
                for end in ends:
                    end.transport.abort()
            return None
        writer.transport.abort()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Forward bytes until the end; the other direction ends with this one."""
        while data := await reader.read(65536):
            await self._flows.wait()
            writer.write(data)
            await writer.drain()
        raise ConnectionResetError
