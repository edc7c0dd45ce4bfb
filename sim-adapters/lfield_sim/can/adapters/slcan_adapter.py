"""An slcan adapter on a pty."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import tty

from lfield.errors import AddressError
from lfield_sim.can.adapters import slcan
from lfield_sim.can.adapters.bus_hub import MAX_WAITING, BusHub
from lfield_sim.can.adapters.slcan import SlcanProtocol
from lfield_sim.can.can_bus import BUS_OFF, BusPort, CanFrame

#: Unread bytes above which an adapter drops lines.
MAX_UNREAD = 1 << 16


class SlcanAdapter:
    """An adapter on a pty, optionally at a symbolic link (which stays when the adapter is plugged in
    again).
    """

    def __init__(self, hub: BusHub, link: str = "") -> None:
        self._hub, self._link = hub, link
        self._loop = asyncio.get_running_loop()
        self.plugged = False

    @property
    def endpoint(self) -> str:
        """The endpoint of the adapter, as in a binding."""
        return f"slcan:{self._link or self._path}@115200"

    def plug(self) -> None:
        """Plugs the adapter in. Raises AddressError when the link cannot be created."""
        # The slave stays open here, so that clients may come and go.
        self._master, self._slave = pty.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._path = os.ttyname(self._slave)
        self.plugged = True
        self._buffer, self._unsent = bytearray(), bytearray()
        port = self._port = BusPort(self._on_frame)
        self._protocol = SlcanProtocol(lambda: BUS_OFF if self._hub.is_off(port) else port.errors)
        self._hub.join(port)
        self._loop.add_reader(self._master, self._readable)
        if self._link:
            _link(self._link, self._path)

    def unplug(self) -> None:
        """Unplugs the adapter: clients get an error."""
        if not self.plugged:
            return
        self.plugged = False
        self._hub.leave(self._port)
        self._loop.remove_reader(self._master)
        self._loop.remove_writer(self._master)
        os.close(self._master)
        os.close(self._slave)
        if self._link and os.path.islink(self._link):
            os.unlink(self._link)

    def close(self) -> None:
        """Closes the adapter."""
        self.unplug()

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._buffer += os.read(self._master, 4096)
        self._pump()

    def _pump(self) -> None:
        while self.plugged and self._port.waiting < MAX_WAITING:
            text = slcan.next_command(self._buffer)
            if text is None:
                self._loop.add_reader(self._master, self._readable)
                return
            answer, frame = self._protocol.command(text)
            self._port.bitrate = self._protocol.bitrate
            self._write(answer)
            if frame:
                self._hub.send(self._port, frame)
        if self.plugged:
            self._loop.remove_reader(self._master)
            self._hub.when_sent(self._pump)

    def _on_frame(self, frame: CanFrame, _: float) -> None:
        if self._protocol.opened:
            self._write(self._protocol.encode(frame))

    def _write(self, data: bytes) -> None:
        """Writes whole lines or nothing: unread lines are dropped, as by real adapters."""
        if len(self._unsent) > MAX_UNREAD:
            return
        self._unsent += data
        self._flush()

    def _flush(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._unsent:
                del self._unsent[: os.write(self._master, self._unsent)]
        if self._unsent:
            self._loop.add_writer(self._master, self._flush)
        else:
            self._loop.remove_writer(self._master)


def _link(link: str, path: str) -> None:
    """Points a symbolic link to a path. Raises AddressError."""
    try:
        if os.path.islink(link):
            os.unlink(link)
        os.symlink(path, link)
    except OSError as error:
        raise AddressError(link, error.strerror or str(error)) from None
