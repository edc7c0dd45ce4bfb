"""A serial line on virtual time: one end is opened by a driver, at the other stands a fake.

Bytes take the time that the baud rate gives them, both ways.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from functools import partial

from lfield.loop import SerialUser
from lfield.simulate.computers.loop import ProcessLoop

#: Bits of a byte on the wire, 8N1; seconds that an adapter takes for anything.
BITS, ADAPTER = 10, 0.0002


class SerialPort:
    """A port with what stands at its far end, from when it is plugged in until it is unplugged."""

    def __init__(
        self, loop: ProcessLoop, received: Callable[[bytes, int], None], gone: Callable[[], None]
    ) -> None:
        self._far, self._received, self._gone = loop, received, gone
        self._near: _Near | None = None
        self._speed = 0
        self._due = 0.0

    def open(self, loop: ProcessLoop, baud: int, user: SerialUser) -> _Near:
        """Open it. Raises OSError when a process that lives has it."""
        if self._near is not None and not self._near.loop.dead:
            raise OSError(errno.EBUSY, "Device or resource busy")
        self._speed, self._near = baud, _Near(self, loop, user)
        return self._near

    def let_go(self, near: _Near) -> None:
        """Who had it open has it no longer."""
        if self._near is near:
            self._near = None

    def to_far(self, data: bytes) -> None:
        """Bytes of the driver."""
        self._later(self._far, len(data), partial(self._received, data, self._speed))

    def write(self, data: bytes) -> None:
        """Bytes of the fake; without a reader they are lost."""
        if (near := self._near) is not None:
            self._later(near.loop, len(data), partial(near.received, data))

    def close(self) -> None:
        """It is unplugged."""
        near, self._near = self._near, None
        self._gone()
        if near is not None:
            near.loop.soon(near.unplugged)

    def _later(self, loop: ProcessLoop, count: int, event: Callable[[], None]) -> None:
        timeline = loop.machine.timeline
        seconds = BITS * count / self._speed if self._speed else 0.0
        self._due = max(self._due, timeline.now + ADAPTER) + seconds
        timeline.at(self._due, partial(loop.enter, event))


class _Near:
    """The end that a driver has open."""

    def __init__(self, port: SerialPort, loop: ProcessLoop, user: SerialUser) -> None:
        self.loop, self._port, self._user = loop, port, user
        self._open = True

    def received(self, data: bytes) -> None:
        """Bytes have come."""
        if self._open:
            self._user.received(data)

    def unplugged(self) -> None:
        """It is gone."""
        if self._open:
            self._open = False
            self._user.unplugged()

    def write(self, data: bytes) -> None:
        """Send bytes. Raises OSError when it is gone."""
        if not self._open:
            raise OSError(errno.EIO, "Input/output error")
        self._port.to_far(bytes(data))

    def close(self) -> None:
        """Give it back."""
        self._open = False
        self._port.let_go(self)
