"""A numbered stream as a transport of asyncio, under the same links as TCP."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from lfield.net.zenoh.stream import Closed, Deliver, Effect, NumberedStream, Opened, SendPacket

if TYPE_CHECKING:
    from lfield.net.stream_link import StreamLink
    from lfield.wire.framing import Buffer

#: The bytes that wait before the writer pauses, if the writer sets no limit.
DEFAULT_HIGH_WATER = 64 << 10


class NoSocket:
    """A substitute for a TCP socket, without options and counters."""

    family = socket.AF_UNSPEC

    def setsockopt(self, level: int, option: int, value: int, /) -> None:
        """Ignore an option of TCP."""

    def getsockopt(self, level: int, option: int, size: int, /) -> bytes:
        """Raises OSError."""
        raise OSError("no socket")


class ZenohPipe(asyncio.Transport):
    """One end of a stream: a shell that executes its effects.

    `send` publishes a packet, `on_end` is called when no more packets will be sent. `peer` is the address of
    the peer as host and port.
    """

    def __init__(
        self,
        stream: NumberedStream,
        peer: tuple[str, int],
        send: Callable[[bytes], None],
        on_end: Callable[[], None],
    ) -> None:
        super().__init__()
        self._stream, self._peer, self._publish, self._on_end = stream, peer, send, on_end
        self._loop = asyncio.get_running_loop()
        self._link: StreamLink | None = None
        self._high, self._low = DEFAULT_HIGH_WATER, DEFAULT_HIGH_WATER // 4
        self._is_writing_paused = self._is_closing = self._is_reading = False
        self._timer: asyncio.Handle | None = None
        #: The time when the timer fires. uvloop's handle of a timer that is due at once does not contain the
        #: time.
        self._timer_due = 0.0
        #: A future that is done when the peer has accepted the stream; with the reason if the stream ended
        #: before.
        self.opened: asyncio.Future[str] = self._loop.create_future()
        # Data that arrives before the link is made waits.
        stream.pause()
        self._update_timer()

    def start(self, link: StreamLink) -> None:
        """Pass the stream to a link."""
        self._link = link
        link.connection_made(self)
        self.resume_reading()

    def pin(self, send: Callable[[bytes], None], on_end: Callable[[], None]) -> None:
        """Make the listener that has answered the peer."""
        self._publish, self._on_end = send, on_end

    # --- from the fabric ----------------------------------------------------------------------------------

    def on_packet(self, data: bytes) -> None:
        """A packet of the peer arrived."""
        self._execute(self._stream.on_packet(data, self._loop.time()))

    def on_suspicion(self) -> None:
        """The session of the peer seems to have ended."""
        self._execute(self._stream.on_suspicion(self._loop.time()))

    # --- asyncio.Transport --------------------------------------------------------------------------------

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        if name == "delivery":
            return self._stream.delivery
        return {"peername": self._peer, "socket": NoSocket()}.get(name, default)

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        self._high = DEFAULT_HIGH_WATER if high is None else high
        self._low = self._high // 4 if low is None else low

    def get_write_buffer_limits(self) -> tuple[int, int]:
        return self._low, self._high

    def get_write_buffer_size(self) -> int:
        """The number of bytes that the peer has not read, including the bytes that the fabric buffers."""
        return self._stream.pending + self._stream.in_flight

    def is_closing(self) -> bool:
        return self._is_closing

    def pause_reading(self) -> None:
        self._is_reading = False
        self._stream.pause()

    def resume_reading(self) -> None:
        # The call is made later, because the caller is a callback of the link.
        self._is_reading = True
        self._loop.call_soon(self._resume)

    def write(self, data: Buffer) -> None:
        if self._is_closing or not data:
            return
        copy = data if isinstance(data, bytes) else bytes(data)
        self._execute(self._stream.write(copy, self._loop.time()))
        if self._stream.pending > self._high and not self._is_writing_paused and self._link is not None:
            self._is_writing_paused = True
            self._link.pause_writing()

    def close(self) -> None:
        if not self._is_closing:
            self._is_closing = True
            self._execute(self._stream.close(self._loop.time()))

    def abort(self) -> None:
        self._is_closing = True
        self._execute(self._stream.abort())

    # --- effects ------------------------------------------------------------------------------------------

    def _resume(self) -> None:
        if self._is_reading:
            self._execute(self._stream.resume(self._loop.time()))

    def _on_timer(self) -> None:
        self._timer = None
        self._execute(self._stream.on_time(self._loop.time()))

    def _execute(self, effects: Iterable[Effect]) -> None:
        for effect in effects:
            match effect:
                case SendPacket(data):
                    self._publish(data)
                case Deliver(data):
                    assert self._link is not None
                    self._link.data_received(data)
                case Opened():
                    self._finish_opening("")
                case Closed(reason):
                    self._is_closing = True
                    self._finish_opening(reason or "closed")
                    self._loop.call_soon(self._end, reason)
        self._resume_writing()
        self._update_timer()

    def _finish_opening(self, reason: str) -> None:
        if not self.opened.done():
            self.opened.set_result(reason)

    def _resume_writing(self) -> None:
        if self._is_writing_paused and self._stream.pending <= self._low and not self._is_closing:
            self._is_writing_paused = False
            assert self._link is not None
            self._link.resume_writing()

    def _end(self, reason: str) -> None:
        self._on_end()
        if self._link is not None:
            self._link.connection_lost(OSError(reason) if reason else None)

    def _update_timer(self) -> None:
        """Set the timer for the next time-out of the stream. A timer that expires too early is kept: it takes
        less time than a new one.
        """
        due = self._stream.deadline
        if self._timer is not None and (due is None or due < self._timer_due):
            self._timer.cancel()
            self._timer = None
        if self._timer is None and due is not None:
            self._timer, self._timer_due = self._loop.call_at(due, self._on_timer), due
