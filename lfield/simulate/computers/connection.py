"""A connection between two processes, as TCP makes them, on ways that fail as radio does.

What is sent while a way is silent waits, as what TCP sends again and again does; that an end was closed
meanwhile is heard of when the way speaks again. So a connection can be half open. A machine that has crashed
answers nothing; once it is on again it refuses what it does not know.
"""

from __future__ import annotations

import asyncio
import errno
import socket
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from lfield.simulate.computers.loop import ProcessLoop
from lfield.simulate.computers.machines import Way, Ways

#: So many bytes the kernels at both ends take before a transport keeps any.
KERNEL = 1 << 20

#: A host's address and a port.
Address = tuple[str, int]


def reset() -> ConnectionResetError:
    """What a process hears of a connection that the other side does not know."""
    return ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")


class Socket:
    """As much of a socket as anybody asks for."""

    family = socket.AF_INET

    def __init__(self, address: tuple[str, int]) -> None:
        self._address = address

    def getsockname(self) -> tuple[str, int]:
        return self._address

    def setsockopt(self, *_: object) -> None:
        """It has no options."""

    def getsockopt(self, *_: object) -> bytes:
        """Nor counters."""
        raise OSError(errno.ENOPROTOOPT, "Protocol not available")

    def dup(self) -> Socket:
        return self

    def listen(self, _: int) -> None:
        """It does."""

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Connection:
    """Two ends."""

    def __init__(
        self, ways: Ways, caller: ProcessLoop, called: ProcessLoop, addresses: tuple[Address, Address]
    ) -> None:
        near, far = End(ways, caller, addresses[1]), End(ways, called, addresses[0])
        near.other, far.other = far, near
        self.ends = (near, far)

    @property
    def over(self) -> bool:
        """Whether neither end is left."""
        return all(end.over for end in self.ends)


class End(asyncio.Transport):
    """One end of a connection, as a transport of its process."""

    other: End

    def __init__(self, ways: Ways, loop: ProcessLoop, peer: Address) -> None:
        super().__init__()
        self.loop, self.machine, self.over = loop, loop.machine, False
        self._ways, self._peer, self._timeline = ways, peer, loop.machine.timeline
        self._protocol: asyncio.Protocol | None = None
        self._closing = False
        self._high = 1 << 30
        #: What this end has sent and the other has not got: bytes; None for the end, an error for a reset.
        self._waiting: deque[bytes | Exception | None] = deque()
        self._pending = 0
        self._is_full = False
        self._due = 0.0
        self._early: list[Callable[[], None]] = []
        #: What has come while nobody wants to read, or None when somebody does.
        self._unread: list[Callable[[], None]] | None = None

    @property
    def way(self) -> Way:
        """From this end to the other."""
        return self.machine.name, self.other.machine.name

    def begin(self, made: Callable[[], asyncio.Protocol]) -> None:
        """The connection is there. Runs inside the process."""
        self._protocol = made()
        self._protocol.connection_made(self)
        early, self._early = self._early, []
        for event in early:
            self.loop.call_soon(event)

    # --- asyncio.Transport ----------------------------------------------------------------------------

    def write(self, data: Any) -> None:
        """Put bytes on their way."""
        if self._closing or self.over:
            return
        self._send(bytes(data))
        if self._pending > KERNEL + self._high and self._protocol is not None and not self._is_full:
            self._is_full = True
            self._protocol.pause_writing()

    def close(self) -> None:
        """Close after what is under way."""
        if not self._closing and not self.over:
            self._closing = True
            self._send(None)
            self.loop.call_soon(self._lost, None)

    def abort(self) -> None:
        """Close at once. What was written is the kernel's, which still sends it."""
        if not self.over:
            self._closing = True
            self._send(reset())
            self.loop.call_soon(self._lost, None)

    def is_closing(self) -> bool:
        """Whether it is closed, or about to be."""
        return self._closing or self.over

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """The other's address, and what stands for a socket."""
        return {"peername": self._peer, "socket": Socket(self._peer)}.get(name, default)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """How much may wait."""
        self._high = high if high is not None else self._high

    def get_write_buffer_size(self) -> int:
        """How much waits."""
        return self._pending

    def is_reading(self) -> bool:
        """Whether what comes is handed on."""
        return self._unread is None and not self.is_closing()

    def pause_reading(self) -> None:
        """What comes waits from now on."""
        if self._unread is None:
            self._unread = []

    def resume_reading(self) -> None:
        """It is handed on again, what has come meanwhile first."""
        unread, self._unread = self._unread or [], None
        for event in unread:
            self.loop.call_soon(partial(self._come, event))

    # --- on the way -----------------------------------------------------------------------------------

    def _send(self, what: bytes | Exception | None) -> None:
        if isinstance(what, bytes):
            self._pending += len(what)
        self._waiting.append(what)
        self._plan()

    def _plan(self) -> None:
        self._due = max(self._due, self._timeline.now + self._ways.delay(self.way))
        self._timeline.at(self._due, self._next)

    def push(self) -> None:
        """The way speaks again."""
        for _ in self._waiting:
            self._plan()

    def _next(self) -> None:
        if not self._waiting or self.way in self._ways.silent:
            return
        what = self._waiting.popleft()
        if isinstance(what, bytes):
            self._pending -= len(what)
            if self._is_full and self._pending <= KERNEL and self._protocol is not None:
                self._is_full = False
                self.loop.call_soon(self._protocol.resume_writing)
        other = self.other
        if other.over or other._closing:
            if isinstance(what, bytes):
                # The other's computer knows no such connection any more, and says so, if it is on.
                other.refuse()
        elif isinstance(what, bytes):
            other.arrive(partial(other._received, what))
        else:
            other.arrive(partial(other._lost, what))

    def refuse(self) -> None:
        """This end is gone: whoever still sends gets a reset, if that way speaks."""
        if self.machine.on and self.way not in self._ways.silent:
            error = reset()
            self.other.arrive(partial(self.other._lost, error))

    def arrive(self, event: Callable[[], None]) -> None:
        """Something comes to this end."""
        self.loop.enter(partial(self._come, event))

    def _come(self, event: Callable[[], None]) -> None:
        if self._unread is None:
            event()
        else:
            self._unread.append(event)

    def _received(self, data: bytes) -> None:
        if self._protocol is None:
            if not self.over:
                self._early.append(partial(self._received, data))
        elif not (self.over or self._closing):
            self._protocol.data_received(data)

    def _lost(self, error: Exception | None) -> None:
        """This end is over: its protocol is told, once."""
        if self.over:
            return
        self.over = self._closing = True
        if self._protocol is not None:
            self._protocol.connection_lost(error)

    def lose(self, error: Exception) -> None:
        """The connection is broken, and this end hears of it."""
        self._waiting.clear()
        self.arrive(partial(self._lost, error))

    def cut_off(self, *, silently: bool) -> None:
        """The process is gone: its kernel closes for it, unless the whole computer is gone."""
        was_over, self.over = self.over, True
        if silently:
            self._waiting.clear()
        elif not was_over and not self._closing:
            self._send(reset())
