"""Connects to the planner: a process on this or another computer that answers each line with a line.

The guard's event loop never blocks. A cancelled request ends the process, or closes the connection; the next
request starts the process, or connects, again.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from lfield.driver import DeviceBinding, DeviceError, Driver
from lfield_planner.device import PlannerDevice

#: Seconds: time-out of a connection attempt. Bytes: maximum length of a line.
CONNECT, LONGEST = 10.0, 1 << 16
#: The command of the planner's process. A planner in another language needs another command.
WORKER = (sys.executable, "-m", "lfield_planner.worker")

Link = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class PlannerDriver(Driver):
    """`process:` starts a planner process and ends it; `tcp:HOST:PORT` connects to a running planner."""

    def __init__(self, *arguments: Any, command: Sequence[str] = WORKER) -> None:
        self._command = command
        self._link: Link | None = None
        self._processes: list[asyncio.subprocess.Process] = []
        super().__init__(*arguments)

    def _device(self, binding: DeviceBinding) -> PlannerDevice:
        return PlannerDevice(binding, self.manifests[binding.type], self.clock, self.reports, self.ask)

    async def _open(self) -> None:
        self._lock = asyncio.Lock()
        await self._connect()
        for device in self.devices.values():
            assert isinstance(device, PlannerDevice)
            self.spawn(device.publish_contact(lambda: self._link is not None and not self._link[0].at_eof()))

    async def _close(self) -> None:
        self._disconnect()
        for process in self._processes:
            await process.wait()

    async def ask(self, line: str) -> str:
        """Sends a request and returns the answer; a cancellation disconnects. Raises DeviceError."""
        async with self._lock:
            try:
                reader, writer = self._link or await self._connect()
                writer.write(f"{line}\n".encode())
                answer = (await reader.readline()).decode("utf-8", "replace").strip()
            except (OSError, ValueError) as error:
                self._disconnect()
                raise self._lost(str(error) or "it is gone") from None
            except asyncio.CancelledError:
                # Otherwise the next request would receive the late answer to this one.
                self._disconnect()
                raise
            if not answer:
                self._disconnect()
                raise self._lost("it ended without an answer")
            return answer

    async def _connect(self) -> Link:
        kind, _, rest = self.endpoint.partition(":")
        host, _, port = rest.rpartition(":")
        try:
            if self.endpoint == "process:":
                self._link = await self._start()
            elif kind == "tcp" and host and port.isdecimal():
                async with asyncio.timeout(CONNECT):
                    self._link = await asyncio.open_connection(host, int(port), limit=LONGEST)
            else:
                raise self._lost("not an endpoint; write process: or tcp:HOST:PORT")
        except OSError as error:
            raise self._lost(error.strerror or str(error) or "no answer") from None
        return self._link

    async def _start(self) -> Link:
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(*self._command, stdin=pipe, stdout=pipe, limit=LONGEST)
        assert process.stdin is not None
        assert process.stdout is not None
        self._processes = [each for each in self._processes if each.returncode is None] + [process]
        return process.stdout, process.stdin

    def _disconnect(self) -> None:
        link, self._link = self._link, None
        if link is not None:
            link[1].close()
        for process in self._processes:
            with suppress(ProcessLookupError):
                process.kill()

    def _lost(self, reason: str) -> DeviceError:
        return DeviceError(
            self.bindings[0].field, f"{self.endpoint}: {reason}", kind="DeviceTimeoutException"
        )
