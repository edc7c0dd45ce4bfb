"""A pseudo-terminal, as behind a USB adapter; on a simulated computer its serial port.

The client finds the pseudo-terminal at a symbolic link, which stays the same when the adapter is unplugged
and plugged in.
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import struct
import tty
from collections.abc import Callable
from pathlib import Path

from lfield.errors import AddressError
from lfield.event_loop import SerialLineEnd, SimulatedLoop

#: Linux' struct termios2, which supports any baud rate: flags, line, characters, speeds.
_TCGETS2, _TERMIOS2 = 0x802C542A, struct.Struct("4I20s2I")

#: Receives a client's data, with its baud rate; None if the system does not report it.
Received = Callable[[bytes, int | None], None]


class Terminal:
    """A serial port at `path`; available from `plug` to `unplug`."""

    def __init__(self, path: Path, on_received: Received) -> None:
        self._path, self._on_received = path, on_received
        self._loop = asyncio.get_running_loop()
        self._ends: tuple[int, int] | None = None
        self._simulated: SerialLineEnd | None = None

    @property
    def plugged(self) -> bool:
        """Whether the adapter is plugged in."""
        return self._ends is not None or self._simulated is not None

    def plug(self) -> None:
        """Plugs the adapter in. Raises AddressError."""
        if self.plugged:
            return
        if isinstance(self._loop, SimulatedLoop):
            try:
                self._simulated = self._loop.plug_serial(str(self._path), self._on_received)
            except OSError as error:
                raise AddressError(str(self._path), error.strerror or str(error)) from None
            return
        if self._path.exists() and not self._path.is_symlink():
            raise AddressError(str(self._path), "there is a file or a device of that name")
        # The slave stays open, otherwise the master reads an error whenever no client has it open.
        master, slave = self._ends = os.openpty()
        tty.setraw(master)
        tty.setraw(slave)
        os.set_blocking(master, False)
        try:
            new_link = self._path.with_name(f".{self._path.name}.{os.getpid()}")
            new_link.unlink(missing_ok=True)
            new_link.symlink_to(os.ttyname(slave))
            new_link.replace(self._path)
        except OSError as error:
            self.unplug()
            raise AddressError(str(self._path), error.strerror or str(error)) from None
        self._loop.add_reader(master, self._read)

    def unplug(self) -> None:
        """Unplugs the adapter: clients get an input/output error."""
        if self._simulated is not None:
            self._simulated.close()
            self._simulated = None
        if self._ends is None:
            return
        master, slave = self._ends
        self._ends = None
        self._loop.remove_reader(master)
        self._path.unlink(missing_ok=True)
        os.close(master)
        os.close(slave)

    def write(self, data: bytes) -> None:
        """Sends bytes. A client that does not read loses some, as at a serial port."""
        if self._simulated is not None:
            self._simulated.write(data)
        if self._ends is None:
            return
        try:
            os.write(self._ends[0], data)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise

    def _read(self) -> None:
        assert self._ends is not None
        try:
            data = os.read(self._ends[0], 4096)
        except BlockingIOError:
            return
        self._on_received(data, _speed(self._ends[1]))


def _speed(terminal: int) -> int | None:
    """The client's bits per second; None if the system does not report it."""
    try:
        answer = fcntl.ioctl(terminal, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        return None
    speed: int = _TERMIOS2.unpack(answer)[-1]
    return speed or None
