"""The driver of one robot, over a TCP connection `tcp:HOST:PORT`. Requests and answers are lines."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from lfield.driver import DeviceBinding, DeviceError, Driver
from lfield_arena.device import POLL_INTERVAL, OmniDevice
from lfield_arena.whistle import WhistleDevice

#: Opens a connection; a test replaces it by a connection in memory.
Connect = Callable[..., Awaitable[tuple[asyncio.StreamReader, asyncio.StreamWriter]]]
#: Seconds: time-out of an answer. Bytes: maximum length of a line.
ANSWER_TIMEOUT, LONGEST = 0.5, 4096


class ArenaDriver(Driver):
    """The connection to a robot. After a failure, the next request connects again."""

    def __init__(self, *arguments: Any, connect: Connect = asyncio.open_connection) -> None:
        self._connect, self._polling = connect, True
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        super().__init__(*arguments)

    def _set_up(self) -> None:
        self._lock = asyncio.Lock()

    def _device(self, binding: DeviceBinding) -> OmniDevice | WhistleDevice:
        kind = WhistleDevice if binding.type == "Whistle" else OmniDevice
        return kind(binding, self.manifests[binding.type], self.clock, self.reports, self.ask)

    async def _open(self) -> None:
        first, *others = self.devices.values()
        if others:
            raise first.error(f"{self.endpoint} supports one robot, with one binding")
        assert isinstance(first, OmniDevice | WhistleDevice)
        self.spawn(self._poll(first))

    async def _close(self) -> None:
        self._disconnect()

    def _quiet(self) -> None:
        # Each request resets the robot's watchdog, which must expire if the host is silent.
        self._polling = False

    def _resume(self) -> None:
        self._polling = True

    async def _poll(self, robot: OmniDevice | WhistleDevice) -> None:
        while True:
            await asyncio.sleep(POLL_INTERVAL)
            if self._polling:
                await robot.poll()

    async def ask(self, line: str) -> str:
        """Sends a request and returns the answer. Raises DeviceError."""
        async with self._lock:
            try:
                async with asyncio.timeout(ANSWER_TIMEOUT):
                    return await self._exchange(line)
            except (TimeoutError, OSError, ValueError) as error:
                self._disconnect()
                reason = getattr(error, "strerror", None) or str(error) or "no answer"
                field = self.bindings[0].field
                problem = f"{self.endpoint}: {reason}"
                raise DeviceError(field, problem, kind="DeviceTimeoutException") from None
            except asyncio.CancelledError:
                # Otherwise the next request would receive the late answer to this one.
                self._disconnect()
                raise

    async def _exchange(self, line: str) -> str:
        if self._streams is None:
            kind, _, rest = self.endpoint.partition(":")
            host, _, port = rest.rpartition(":")
            if kind != "tcp" or not port.isdecimal():
                raise OSError("not an endpoint; write tcp:HOST:PORT")
            self._streams = await self._connect(host, int(port), limit=LONGEST)
        reader, writer = self._streams
        writer.write(f"{line}\n".encode())
        answer = (await reader.readline()).decode("ascii", "replace").strip()
        if not answer:
            raise OSError("it closed the link")
        return answer

    def _disconnect(self) -> None:
        streams, self._streams = self._streams, None
        if streams is not None:
            streams[1].close()
