"""The pipes between a process and its child, and the notification of its end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from lfield.simulate.computers.process_loop import ProcessLoop

#: Delay of bytes through a pipe in seconds, due to scheduling.
PIPE_DELAY = (0.00005, 0.001)


class PipeEnd(asyncio.WriteTransport):
    """The writing end of a pipe; bytes arrive at `deliver` in the other process."""

    def __init__(self, writer: ProcessLoop, reader: ProcessLoop, deliver: Callable[[bytes], None]) -> None:
        super().__init__()
        self._writer, self._reader, self._deliver = writer, reader, deliver
        self._due = 0.0
        self._closing = False

    def write(self, data: Any) -> None:
        """Writes bytes."""
        if not (self._closing or self._reader.dead or self._writer.dead):
            self._later(partial(self._deliver, bytes(data)))

    def _later(self, event: Callable[[], None]) -> None:
        machine = self._writer.machine
        now = machine.timeline.now
        self._due = max(self._due, now + machine.rng.uniform(*PIPE_DELAY))
        machine.timeline.at(self._due, partial(self._reader.enter, event))

    def end(self, event: Callable[[], None]) -> None:
        """Schedules an event in the reader after all written bytes: the end of the pipe."""
        self._closing = True
        self._later(event)

    def close(self) -> None:
        """Closes the writing end."""
        self._closing = True

    def is_closing(self) -> bool:
        return self._closing or self._reader.dead

    def get_write_buffer_size(self) -> int:
        """Always 0: the pipe accepts all bytes at once."""
        return 0


class StartedProcess(Protocol):
    """A process started by another one."""

    pid: int

    @property
    def loop(self) -> ProcessLoop:
        """The loop of the process."""

    def await_end(self, on_end: Callable[[int], None]) -> None:
        """Sets a function that is called with the exit status."""

    def received(self, data: bytes) -> None:
        """Receives bytes on stdin. Runs inside the process."""

    def die(self, status: int) -> None:
        """Ends the process now."""


class ChildProcess(asyncio.SubprocessTransport):
    """A child process, as its parent's transport."""

    def __init__(
        self, parent: ProcessLoop, child: StartedProcess, protocol: asyncio.SubprocessProtocol
    ) -> None:
        super().__init__()
        self._parent, self._child, self._protocol = parent, child, protocol
        self._status: int | None = None
        self._stdin = PipeEnd(parent, child.loop, child.received)
        self.stdout = PipeEnd(child.loop, parent, partial(protocol.pipe_data_received, 1))
        child.await_end(self._ended)

    def get_pid(self) -> int:
        """The process id."""
        return self._child.pid

    def get_returncode(self) -> int | None:
        """The exit status; None while the process runs."""
        return self._status

    def get_pipe_transport(self, fd: int) -> asyncio.BaseTransport | None:
        """The stdin of the process."""
        return self._stdin if fd == 0 else None

    def close(self) -> None:
        """Has no effect: the process is no longer awaited."""

    def kill_now(self) -> None:
        """Kills the process as by SIGKILL, slightly delayed: the caller continues first."""
        self._child.loop.machine.timeline.after(0.0, partial(self._child.die, -9))

    def _ended(self, status: int) -> None:
        if not self._parent.dead:
            self.stdout.end(partial(self._notify_parent, status))

    def _notify_parent(self, status: int) -> None:
        self._status = status
        self._protocol.process_exited()
        self._protocol.connection_lost(None)
