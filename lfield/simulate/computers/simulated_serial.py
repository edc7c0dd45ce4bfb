"""A serial line on virtual time between a driver and a fake.

Bytes take the time of the baud rate, in both directions.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from functools import partial

from lfield.event_loop import SerialUser
from lfield.simulate.computers.process_loop import ProcessLoop

#: Bits per byte on the wire, 8N1; latency of an adapter in seconds.
BITS, ADAPTER = 10, 0.0002


class SimulatedSerialPort:
    """A port with its far end, from plugging in to unplugging."""

    def __init__(
        self, loop: ProcessLoop, received: Callable[[bytes, int], None], gone: Callable[[], None]
    ) -> None:
        self._far, self._received, self._gone = loop, received, gone
        self._near: _Near | None = None
        self._speed = 0
        self._due = 0.0

    def open(self, loop: ProcessLoop, baud: int, user: SerialUser) -> _Near:
        """Opens the port. Raises OSError when another process has it open."""
        if self._near is not None and not self._near.loop.dead:
            raise OSError(errno.EBUSY, "Device or resource busy")
        self._speed, self._near = baud, _Near(self, loop, user)
        return self._near

    def release(self, near: _Near) -> None:
        """Closes the near end of the port."""
        if self._near is near:
            self._near = None

    def to_far(self, data: bytes) -> None:
        """Delivers bytes of the driver."""
        self._later(self._far, len(data), partial(self._received, data, self._speed))

    def write(self, data: bytes) -> None:
        """Delivers bytes of the simulated device; lost without a reader."""
        if (near := self._near) is not None:
            self._later(near.loop, len(data), partial(near.received, data))

    def close(self) -> None:
        """Unplugs the port."""
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
    """The end of a driver."""

    def __init__(self, port: SimulatedSerialPort, loop: ProcessLoop, user: SerialUser) -> None:
        self.loop, self._port, self._user = loop, port, user
        self._open = True

    def received(self, data: bytes) -> None:
        """Delivers bytes that have arrived."""
        if self._open:
            self._user.received(data)

    def unplugged(self) -> None:
        if self._open:
            self._open = False
            self._user.unplugged()

    def write(self, data: bytes) -> None:
        """Sends bytes. Raises OSError when the port is gone."""
        if not self._open:
            raise OSError(errno.EIO, "Input/output error")
        self._port.to_far(bytes(data))

    def close(self) -> None:
        self._open = False
        self._port.release(self)
