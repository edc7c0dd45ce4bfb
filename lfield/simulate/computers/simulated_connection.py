"""A TCP connection between two processes, over a network with failures like radio.

Data sent while a path is silent waits, like TCP's retransmissions; a close is noticed when the path works
again, so a connection can be half open. A crashed machine answers nothing; after a restart it resets unknown
connections.
"""

from __future__ import annotations

import asyncio
import errno
import socket
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from lfield.simulate.computers.process_loop import ProcessLoop
from lfield.simulate.computers.simulated_machine import NetworkPath, NetworkPaths

#: Bytes that a kernel buffers before a transport does (`TCP_NOTSENT_LOWAT`): links queue the others.
SEND_BUFFER = 1 << 10

#: A host's address and a port.
Address = tuple[str, int]


def reset() -> ConnectionResetError:
    """The error for a connection that the other side does not know."""
    return ConnectionResetError(errno.ECONNRESET, "Connection reset by peer")


class SimulatedSocket:
    """The used part of a socket."""

    family = socket.AF_INET

    def __init__(self, address: tuple[str, int]) -> None:
        self._address = address

    def getsockname(self) -> tuple[str, int]:
        return self._address

    def setsockopt(self, *_: object) -> None:
        """Has no effect: the socket has no options."""

    def getsockopt(self, *_: object) -> bytes:
        """Raises OSError: the socket has no counters."""
        raise OSError(errno.ENOPROTOOPT, "Protocol not available")

    def dup(self) -> SimulatedSocket:
        return self

    def listen(self, _: int) -> None:
        """Has no effect."""

    def __enter__(self) -> SimulatedSocket:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class SimulatedConnection:
    """A connection with its two ends."""

    def __init__(
        self,
        paths: NetworkPaths,
        caller: ProcessLoop,
        called: ProcessLoop,
        addresses: tuple[Address, Address],
    ) -> None:
        caller_end, called_end = (
            ConnectionEnd(paths, caller, addresses[1]),
            ConnectionEnd(paths, called, addresses[0]),
        )
        caller_end.other, called_end.other = called_end, caller_end
        self.ends = (caller_end, called_end)

    @property
    def is_over(self) -> bool:
        """Whether both ends are closed."""
        return all(end.is_over for end in self.ends)


class ConnectionEnd(asyncio.Transport):
    """One end of a connection, as a transport of its process."""

    other: ConnectionEnd

    def __init__(self, paths: NetworkPaths, loop: ProcessLoop, peer: Address) -> None:
        super().__init__()
        self.loop, self.machine, self.is_over = loop, loop.machine, False
        self._paths, self._peer, self._timeline = paths, peer, loop.machine.timeline
        self._protocol: asyncio.Protocol | None = None
        self._closing = False
        self._high = 1 << 30
        #: Data not yet delivered: bytes; None for the end, an error for a reset.
        self._waiting: deque[bytes | Exception | None] = deque()
        self._pending = 0
        self._is_full = False
        self._due = 0.0
        self._early: list[Callable[[], None]] = []
        #: Events while reading is paused, None when it is not.
        self._unread: list[Callable[[], None]] | None = None

    @property
    def path(self) -> NetworkPath:
        return self.machine.name, self.other.machine.name

    def start(self, make_protocol: Callable[[], asyncio.Protocol]) -> None:
        """Notifies the protocol of the connection. Runs inside the process."""
        self._protocol = make_protocol()
        self._protocol.connection_made(self)
        early, self._early = self._early, []
        for event in early:
            self.loop.call_soon(event)

    # --- asyncio.Transport ----------------------------------------------------------------------------

    def write(self, data: Any) -> None:
        """Sends bytes."""
        if self._closing or self.is_over:
            return
        self._send(bytes(data))
        if self._pending > SEND_BUFFER + self._high and self._protocol is not None and not self._is_full:
            self._is_full = True
            self._protocol.pause_writing()

    def close(self) -> None:
        """Closes after pending data."""
        if not self._closing and not self.is_over:
            self._closing = True
            self._send(None)
            self.loop.call_soon(self._close, None)

    def abort(self) -> None:
        """Closes at once. The kernel still sends written data."""
        if not self.is_over:
            self._closing = True
            self._send(reset())
            self.loop.call_soon(self._close, None)

    def is_closing(self) -> bool:
        return self._closing or self.is_over

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """The peer's address, and the socket."""
        return {"peername": self._peer, "socket": SimulatedSocket(self._peer)}.get(name, default)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = high if high is not None else self._high

    def get_write_buffer_size(self) -> int:
        """Bytes in the buffer."""
        return self._pending

    def is_reading(self) -> bool:
        """Whether events are delivered."""
        return self._unread is None and not self.is_closing()

    def pause_reading(self) -> None:
        """Holds back events from now on."""
        if self._unread is None:
            self._unread = []

    def resume_reading(self) -> None:
        """Delivers held-back and later events."""
        unread, self._unread = self._unread or [], None
        for event in unread:
            self.loop.call_soon(partial(self._deliver, event))

    # --- delivery -------------------------------------------------------------------------------------

    def _send(self, item: bytes | Exception | None) -> None:
        if isinstance(item, bytes):
            self._pending += len(item)
        self._waiting.append(item)
        self._plan()

    def _plan(self) -> None:
        self._due = max(self._due, self._timeline.now + self._paths.delay(self.path))
        self._timeline.at(self._due, self._next)

    def push(self) -> None:
        """Delivers pending data, since the path works again."""
        for _ in self._waiting:
            self._plan()

    def _next(self) -> None:
        if not self._waiting or self.path in self._paths.silent:
            return
        item = self._waiting.popleft()
        if isinstance(item, bytes):
            self._pending -= len(item)
            if self._is_full and self._pending <= SEND_BUFFER and self._protocol is not None:
                self._is_full = False
                self.loop.call_soon(self._protocol.resume_writing)
        other = self.other
        if other.is_over or other._closing:
            if isinstance(item, bytes):
                # The other computer does not know the connection any more, and resets it if it is on.
                other.refuse()
        elif isinstance(item, bytes):
            other.arrive(partial(other._received, item))
        else:
            other.arrive(partial(other._close, item))

    def refuse(self) -> None:
        """Answers a later sender by a reset after the loss of this end, if that path works."""
        if self.machine.is_on and self.path not in self._paths.silent:
            error = reset()
            self.other.arrive(partial(self.other._close, error))

    def arrive(self, event: Callable[[], None]) -> None:
        self.loop.enter(partial(self._deliver, event))

    def _deliver(self, event: Callable[[], None]) -> None:
        if self._unread is None:
            event()
        else:
            self._unread.append(event)

    def _received(self, data: bytes) -> None:
        if self._protocol is None:
            if not self.is_over:
                self._early.append(partial(self._received, data))
        elif not (self.is_over or self._closing):
            self._protocol.data_received(data)

    def _close(self, error: Exception | None) -> None:
        """Closes this end and notifies its protocol once."""
        if self.is_over:
            return
        self.is_over = self._closing = True
        if self._protocol is not None:
            self._protocol.connection_lost(error)

    def lose(self, error: Exception) -> None:
        """Breaks the connection, and notifies this end."""
        self._waiting.clear()
        self.arrive(partial(self._close, error))

    def cut_off(self, *, silently: bool) -> None:
        """Closes the connection of a process that is gone, unless the whole computer is gone."""
        was_over, self.is_over = self.is_over, True
        if silently:
            self._waiting.clear()
        elif not was_over and not self._closing:
            self._send(reset())
