"""What stands between a process and its child: two pipes, and the news of its end."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from lfield.simulate.computers.loop import ProcessLoop

#: Seconds that bytes take through a pipe: until the other is scheduled.
THROUGH = (0.00005, 0.001)


class PipeEnd(asyncio.WriteTransport):
    """The writing end of a pipe: bytes come out at `deliver`, in the other process."""

    def __init__(self, writer: ProcessLoop, reader: ProcessLoop, deliver: Callable[[bytes], None]) -> None:
        super().__init__()
        self._writer, self._reader, self._deliver = writer, reader, deliver
        self._due = 0.0
        self._closing = False

    def write(self, data: Any) -> None:
        """Put bytes in."""
        if not (self._closing or self._reader.dead or self._writer.dead):
            self._later(partial(self._deliver, bytes(data)))

    def _later(self, event: Callable[[], None]) -> None:
        machine = self._writer.machine
        now = machine.timeline.now
        self._due = max(self._due, now + machine.dice.uniform(*THROUGH))
        machine.timeline.at(self._due, partial(self._reader.enter, event))

    def end(self, event: Callable[[], None]) -> None:
        """After all that was written, this happens in the reader: it is the end of the pipe."""
        self._closing = True
        self._later(event)

    def close(self) -> None:
        """Nothing more is written."""
        self._closing = True

    def is_closing(self) -> bool:
        """Whether it is closed."""
        return self._closing or self._reader.dead

    def get_write_buffer_size(self) -> int:
        """It takes everything at once."""
        return 0


class Born(Protocol):
    """A process that another one has started."""

    pid: int
    on_end: Callable[[int], None]

    @property
    def loop(self) -> ProcessLoop:
        """Its loop."""

    def received(self, data: bytes) -> None:
        """Bytes came through its stdin. Runs inside it."""

    def die(self, status: int) -> None:
        """It ends now."""


class Child(asyncio.SubprocessTransport):
    """A child process, as its parent's transport."""

    def __init__(self, parent: ProcessLoop, child: Born, protocol: asyncio.SubprocessProtocol) -> None:
        super().__init__()
        self._parent, self._child, self._protocol = parent, child, protocol
        self._status: int | None = None
        self._stdin = PipeEnd(parent, child.loop, child.received)
        self.stdout = PipeEnd(child.loop, parent, partial(protocol.pipe_data_received, 1))
        child.on_end = self._ended

    def get_pid(self) -> int:
        """Its number."""
        return self._child.pid

    def get_returncode(self) -> int | None:
        """How it ended; None while it has not."""
        return self._status

    def get_pipe_transport(self, fd: int) -> asyncio.BaseTransport | None:
        """Its stdin."""
        return self._stdin if fd == 0 else None

    def close(self) -> None:
        """Nobody waits for it any more."""

    def kill_now(self) -> None:
        """As SIGKILL, a moment later: whoever does it goes on first."""
        self._child.loop.machine.timeline.after(0.0, partial(self._child.die, -9))

    def _ended(self, status: int) -> None:
        if not self._parent.dead:
            self.stdout.end(partial(self._told, status))

    def _told(self, status: int) -> None:
        self._status = status
        self._protocol.process_exited()
        self._protocol.connection_lost(None)
