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
        self, loop: ProcessLoop, on_data: Callable[[bytes, int], None], on_close: Callable[[], None]
    ) -> None:
        self._device_loop, self._on_data, self._on_close = loop, on_data, on_close
        self._open_end: _OpenEnd | None = None
        self._speed = 0
        self._due = 0.0

    def open(self, loop: ProcessLoop, baud: int, user: SerialUser) -> _OpenEnd:
        """Opens the port. Raises OSError when another process has it open."""
        if self._open_end is not None and not self._open_end.loop.dead:
            raise OSError(errno.EBUSY, "Device or resource busy")
        self._speed, self._open_end = baud, _OpenEnd(self, loop, user)
        return self._open_end

    def release(self, end: _OpenEnd) -> None:
        """Closes the near end of the port."""
        if self._open_end is end:
            self._open_end = None

    def to_far(self, data: bytes) -> None:
        """Delivers bytes of the driver."""
        self._later(self._device_loop, len(data), partial(self._on_data, data, self._speed))

    def write(self, data: bytes) -> None:
        """Delivers bytes of the simulated device; lost without a reader."""
        if (end := self._open_end) is not None:
            self._later(end.loop, len(data), partial(end.received, data))

    def close(self) -> None:
        """Unplugs the port."""
        end, self._open_end = self._open_end, None
        self._on_close()
        if end is not None:
            end.loop.soon(end.unplugged)

    def _later(self, loop: ProcessLoop, count: int, event: Callable[[], None]) -> None:
        timeline = loop.machine.timeline
        seconds = BITS * count / self._speed if self._speed else 0.0
        self._due = max(self._due, timeline.now + ADAPTER) + seconds
        timeline.at(self._due, partial(loop.enter, event))


class _OpenEnd:
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
