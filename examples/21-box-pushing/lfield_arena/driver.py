"""One robot behind one connection, `tcp:HOST:PORT`. Requests and answers are lines."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from lfield.driver import DeviceBinding, DeviceError, Driver
from lfield_arena.device import POLL, OmniDevice
from lfield_arena.whistle import WhistleDevice

#: Opens a link: by asyncio, or in a test to a simulated device in memory.
Connect = Callable[..., Awaitable[tuple[asyncio.StreamReader, asyncio.StreamWriter]]]
#: Seconds for an answer; bytes of the longest line.
ANSWER, LONGEST = 0.5, 4096


class ArenaDriver(Driver):
    """The link to a robot; after a failure the next request reconnects."""

    def __init__(self, *given: Any, connect: Connect = asyncio.open_connection) -> None:
        self._connect, self._polling = connect, True
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        super().__init__(*given)

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
        # Every request feeds the robot's watchdog; none are sent while the host is silent.
        self._polling = False

    def _resume(self) -> None:
        self._polling = True

    async def _poll(self, robot: OmniDevice | WhistleDevice) -> None:
        while True:
            await asyncio.sleep(POLL)
            if self._polling:
                await robot.poll()

    async def ask(self, line: str) -> str:
        """One request and its answer. Raises DeviceError."""
        async with self._lock:
            try:
                async with asyncio.timeout(ANSWER):
                    return await self._exchange(line)
            except (TimeoutError, OSError, ValueError) as error:
                self._disconnect()
                reason = getattr(error, "strerror", None) or str(error) or "no answer"
                field = self.bindings[0].field
                problem = f"{self.endpoint}: {reason}"
                raise DeviceError(field, problem, kind="DeviceTimeoutException") from None
            except asyncio.CancelledError:
                # The late answer would be taken for that to the next request.
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
