"""The chain in real time behind a pseudo-terminal, as behind a USB adapter.

The client finds it at a symbolic link, which stays the same when the adapter is pulled out and put back.
A client with another baud rate than a servo is not heard by it: the speed is asked of the terminal (Linux).
"""

from __future__ import annotations

import asyncio
import errno
import fcntl
import os
import struct
import time
import tty
from collections.abc import Callable
from pathlib import Path

from lfield.errors import AddressError
from lfield_sim.dynamixel.chain import Chain, Reply

#: How often the servos move when nobody asks, in seconds.
TICK = 0.02
#: asyncio wakes up a millisecond late: the last COARSE seconds are slept; GRAIN is not worth waiting for.
COARSE, GRAIN = 0.002, 0.0001
#: Linux' struct termios2, which knows speeds that have no name: flags, line, characters, speeds.
_TCGETS2, _TERMIOS2 = 0x802C542A, struct.Struct("4I20s2I")


class Server:
    """One adapter with its chain. It stays plugged in until `unplug`.

    `moved` is called whenever a servo may have changed.
    """

    def __init__(self, chain: Chain, path: Path, moved: Callable[[], None]) -> None:
        self._chain, self._path, self._moved = chain, path, moved
        self._loop = asyncio.get_running_loop()
        self._ends: tuple[int, int] | None = None
        chain.faults.watch(self._follow)

    @property
    def now(self) -> float:
        """The chain's time."""
        return time.monotonic()

    def plug(self) -> None:
        """Be there. Raises AddressError."""
        if self._ends is not None:
            return
        if self._path.exists() and not self._path.is_symlink():
            raise AddressError(str(self._path), "there is a file or a device of that name")
        # The slave's end stays open, or the master reads an error whenever no client is there.
        master, slave = self._ends = os.openpty()
        tty.setraw(master)
        tty.setraw(slave)
        os.set_blocking(master, False)
        try:
            fresh = self._path.with_name(f".{self._path.name}.{os.getpid()}")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(os.ttyname(slave))
            fresh.replace(self._path)
        except OSError as error:
            self.unplug()
            raise AddressError(str(self._path), error.strerror or str(error)) from None
        self._loop.add_reader(master, self._read)

    def unplug(self) -> None:
        """Be gone: clients get an input/output error."""
        if self._ends is None:
            return
        master, slave = self._ends
        self._ends = None
        self._loop.remove_reader(master)
        self._path.unlink(missing_ok=True)
        os.close(master)
        os.close(slave)

    def _follow(self) -> None:
        """Be where the faults say. Raises ValueError, which whoever sets them is told."""
        if self._chain.faults.get("unplug"):
            self.unplug()
            return
        try:
            self.plug()
        except AddressError as error:
            raise ValueError(str(error)) from None

    def _read(self) -> None:
        assert self._ends is not None
        try:
            data = os.read(self._ends[0], 4096)
        except BlockingIOError:
            return
        replies = self._chain.receive(data, self.now, _speed(self._ends[1]))
        self._moved()
        for reply in replies:
            self._send(reply)

    def _send(self, reply: Reply) -> None:
        left = reply.at - self.now
        if left > COARSE:
            self._loop.call_later(left - COARSE / 2, self._write, reply)
        else:
            self._write(reply)

    def _write(self, reply: Reply) -> None:
        left = reply.at - self.now
        if left > GRAIN:
            time.sleep(left)
        if self._ends is None:
            return
        try:
            os.write(self._ends[0], reply.data)
        except OSError as error:
            # A client that reads nothing loses bytes, as it does at a serial port.
            if error.errno not in (errno.EAGAIN, errno.EIO):
                raise

    async def run(self) -> None:
        """Let the servos move, for ever."""
        while True:
            self._chain.advance(self.now)
            self._moved()
            await asyncio.sleep(TICK)


def _speed(terminal: int) -> int | None:
    """Bits per second that the client has set; None where the system does not say."""
    try:
        answer = fcntl.ioctl(terminal, _TCGETS2, bytes(_TERMIOS2.size))
    except OSError:
        return None
    speed: int = _TERMIOS2.unpack(answer)[-1]
    return speed or None
